"""What the control groups (v1, v2 or hybrid) allow and what was used of it; ``root`` is another tree in tests.

A ``0::PATH`` line in /proc/self/cgroup alone says nothing: on hybrid systems there are no controllers behind it.
"""

import os

_NO_LIMIT = 1 << 60


class Limit:
    """``value``: cores or bytes that the group at ``folder`` (of hierarchy ``version``) may use."""

    __slots__ = ("folder", "value", "version")

    def __init__(self, value, folder: str, version: int) -> None:
        self.value, self.folder, self.version = value, folder, version


def _text(path: str) -> str:
    try:
        with open(path, "rb") as file:
            return file.read().decode("ascii", "replace").strip()
    except OSError:
        return ""


def _numbers(path: str) -> dict:
    """``name value`` lines."""
    pairs = (line.split() for line in _text(path).splitlines())
    return {pair[0]: int(pair[1]) for pair in pairs if len(pair) == 2 and pair[1].isdigit()}


def _groups(root: str, controller: str) -> list:
    """(directory, version) from our own group up to the top of the hierarchy that has ``controller``."""
    v2_path = ""
    for line in _text(root + "/proc/self/cgroup").splitlines():
        number, _, rest = line.partition(":")
        names, _, path = rest.partition(":")
        if controller in names.split(","):
            mount = "%s/sys/fs/cgroup/%s" % (root, names)
            return _upwards(
                mount if os.path.isdir(mount) else "%s/sys/fs/cgroup/%s" % (root, controller), path, 1
            )
        if number == "0" and not names:
            v2_path = path
    for mount in (root + "/sys/fs/cgroup", root + "/sys/fs/cgroup/unified"):
        if controller in _text(mount + "/cgroup.controllers").split():
            return _upwards(mount, v2_path, 2)
    return []


def _upwards(mount: str, path: str, version: int) -> list:
    found, path = [], path.strip("/")
    while path:
        found.append(("%s/%s" % (mount, path), version))
        path = path.rpartition("/")[0]
    return found + [(mount, version)]


def _quota(folder: str, version: int) -> float:
    """Cores; 0 where there is no quota."""
    if version == 2:
        quota, _, period = _text(folder + "/cpu.max").partition(" ")
    else:
        quota, period = _text(folder + "/cpu.cfs_quota_us"), _text(folder + "/cpu.cfs_period_us")
    if not quota.isdigit() or not period.isdigit() or not int(period):
        return 0.0
    return int(quota) / int(period)


def is_v2(root: str = "") -> bool:
    """Whether the controllers stand in the one hierarchy of version 2."""
    return os.path.exists(root + "/sys/fs/cgroup/cgroup.controllers")


def cpu_limit(root: str = ""):
    """The smallest CPU quota in cores on the way up as a Limit; None where nothing limits."""
    found = [Limit(_quota(folder, version), folder, version) for folder, version in _groups(root, "cpu")]
    return min((limit for limit in found if limit.value > 0), key=lambda limit: limit.value, default=None)


def cpu_used_s(limit: Limit, root: str = "") -> float:
    """CPU seconds that the limited group has used; -1 where its accounting cannot be read."""
    if limit.version == 2:
        used = _numbers(limit.folder + "/cpu.stat").get("usage_usec")
        return -1.0 if used is None else used / 1e6
    # The quota may stand in hierarchy ``cpu`` and the accounting in ``cpuacct``, under the same path.
    below = limit.folder[len(root + "/sys/fs/cgroup/") :].partition("/")[2]
    for mount in ("cpuacct", "cpu,cpuacct", "cpuacct,cpu"):
        text = _text(os.path.join(root + "/sys/fs/cgroup", mount, below, "cpuacct.usage"))
        if text.isdigit():
            return int(text) / 1e9
    return -1.0


def memory_limit(root: str = ""):
    """The smallest memory limit in bytes on the way up as a Limit; None where nothing limits."""
    found = []
    for folder, version in _groups(root, "memory"):
        text = _text(folder + ("/memory.max" if version == 2 else "/memory.limit_in_bytes"))
        if text.isdigit() and 0 < int(text) < _NO_LIMIT:
            found.append(Limit(int(text), folder, version))
    return min(found, key=lambda limit: limit.value, default=None)


def memory_used(limit: Limit) -> int:
    """Bytes in use in the limited group without what the kernel would give back at once: page cache, but not shared memory."""
    folder = limit.folder
    numbers = _numbers(folder + "/memory.stat")
    if limit.version == 2:
        used, cache = _text(folder + "/memory.current"), numbers.get("file", 0) - numbers.get("shmem", 0)
    else:
        used = _text(folder + "/memory.usage_in_bytes")
        cache = numbers.get("total_cache", 0) - numbers.get("total_shmem", 0)
    return max(0, int(used or 0) - max(0, cache))
