# SPDX-License-Identifier: Apache-2.0
"""Limits and usage of control groups v1, v2 and hybrid; ``root`` is another tree in tests.

A ``0::PATH`` line in /proc/self/cgroup alone is no evidence: on hybrid systems there are no controllers
behind it.
"""

import os

from . import proc

_NO_LIMIT = 1 << 60


class CgroupLimit:
    """Limit of a control group: ``value`` cores or bytes for the group at ``folder`` of hierarchy ``version``
    (1 or 2).
    """

    __slots__ = ("folder", "value", "version")

    def __init__(self, value: float, folder: str, version: int) -> None:
        self.value, self.folder, self.version = value, folder, version


def _read_text(path: str) -> str:
    return proc.read_file(path).decode("ascii", "replace").strip()


def _read_numbers(path: str) -> "dict[str, int]":
    """Read lines ``name value``."""
    pairs = (line.split() for line in _read_text(path).splitlines())
    return {pair[0]: int(pair[1]) for pair in pairs if len(pair) == 2 and pair[1].isdigit()}


def _list_groups(root: str, controller: str, process: str = "self") -> "list[tuple[str, int]]":
    """List (directory, version) from the group of a process (the agent's own) up to the top of the hierarchy
    that has ``controller``.
    """
    v2_path = ""
    for line in _read_text("%s/proc/%s/cgroup" % (root, process)).splitlines():
        number, _, rest = line.partition(":")
        names, _, path = rest.partition(":")
        if controller in names.split(","):
            mount = "%s/sys/fs/cgroup/%s" % (root, names)
            return _list_ancestors(
                mount if os.path.isdir(mount) else "%s/sys/fs/cgroup/%s" % (root, controller), path, 1
            )
        if number == "0" and not names:
            v2_path = path
    for mount in (root + "/sys/fs/cgroup", root + "/sys/fs/cgroup/unified"):
        if controller in _read_text(mount + "/cgroup.controllers").split():
            return _list_ancestors(mount, v2_path, 2)
    return []


def _list_ancestors(mount: str, path: str, version: int) -> "list[tuple[str, int]]":
    found: "list[tuple[str, int]]" = []
    path = path.strip("/")
    while path:
        found.append(("%s/%s" % (mount, path), version))
        path = path.rpartition("/")[0]
    return found + [(mount, version)]


def _read_cpu_quota(folder: str, version: int) -> float:
    """Read the quota in cores; 0 where there is none."""
    if version == 2:
        quota, _, period = _read_text(folder + "/cpu.max").partition(" ")
    else:
        quota, period = _read_text(folder + "/cpu.cfs_quota_us"), _read_text(folder + "/cpu.cfs_period_us")
    if not quota.isdigit() or not period.isdigit() or not int(period):
        return 0.0
    return int(quota) / int(period)


def is_v2(root: str = "") -> bool:
    """Whether all controllers are in the one hierarchy of version 2."""
    return os.path.exists(root + "/sys/fs/cgroup/cgroup.controllers")


def find_cpu_limit(root: str = "") -> "CgroupLimit | None":
    """Find the smallest CPU quota (cores) of the agent's group and its ancestors.

    None where there is none.
    """
    found = [
        CgroupLimit(_read_cpu_quota(folder, version), folder, version)
        for folder, version in _list_groups(root, "cpu")
    ]
    return min((limit for limit in found if limit.value > 0), key=lambda limit: limit.value, default=None)


def read_cpu_used_s(limit: CgroupLimit, root: str = "") -> float:
    """Read the CPU seconds that the limited group has used; -1 where its accounting cannot be read."""
    if limit.version == 2:
        used = _read_numbers(limit.folder + "/cpu.stat").get("usage_usec")
        return -1.0 if used is None else used / 1e6
    # The quota may be in hierarchy ``cpu`` and the accounting in ``cpuacct``, under the same path.
    below = limit.folder[len(root + "/sys/fs/cgroup/") :].partition("/")[2]
    for mount in ("cpuacct", "cpu,cpuacct", "cpuacct,cpu"):
        text = _read_text(os.path.join(root + "/sys/fs/cgroup", mount, below, "cpuacct.usage"))
        if text.isdigit():
            return int(text) / 1e9
    return -1.0


def find_memory_limit(root: str = "") -> "CgroupLimit | None":
    """Find the smallest memory limit (bytes) of the agent's group and its ancestors.

    None where there is none.
    """
    found = []
    for folder, version in _list_groups(root, "memory"):
        text = _read_text(folder + ("/memory.max" if version == 2 else "/memory.limit_in_bytes"))
        if text.isdigit() and 0 < int(text) < _NO_LIMIT:
            found.append(CgroupLimit(int(text), folder, version))
    return min(found, key=lambda limit: limit.value, default=None)


def read_container_cpu_s(pid: int, root: str = "") -> float:
    """Read the CPU seconds of the control group of a container with process ``pid``, since it was created; -1
    where that cannot be read.
    """
    # Version 1 counts in cpuacct, which need not be where the quota is.
    for controller in ("cpuacct", "cpu"):
        for folder, version in _list_groups(root, controller, str(pid))[:1]:
            return read_cpu_used_s(CgroupLimit(0.0, folder, version), root)
    return -1.0


def read_container_memory(pid: int, root: str = "") -> int:
    """Read the bytes of the control group of a container with process ``pid``, as `read_memory_used`; -1
    where that cannot be read.
    """
    for folder, version in _list_groups(root, "memory", str(pid))[:1]:
        name = "memory.current" if version == 2 else "memory.usage_in_bytes"
        if os.path.exists(os.path.join(folder, name)):
            return read_memory_used(CgroupLimit(0.0, folder, version))
    return -1


def read_memory_used(limit: CgroupLimit) -> int:
    """Read the bytes in use in the limited group without reclaimable page cache.

    Shared memory counts as used.
    """
    folder = limit.folder
    numbers = _read_numbers(folder + "/memory.stat")
    if limit.version == 2:
        used, cache = _read_text(folder + "/memory.current"), numbers.get("file", 0) - numbers.get("shmem", 0)
    else:
        used = _read_text(folder + "/memory.usage_in_bytes")
        cache = numbers.get("total_cache", 0) - numbers.get("total_shmem", 0)
    return max(0, int(used or 0) - max(0, cache))
