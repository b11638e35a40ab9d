# SPDX-License-Identifier: Apache-2.0
"""Limits of control groups v1, v2 and hybrid; ``root`` is another tree in tests.

A ``0::PATH`` line in /proc/self/cgroup alone is no evidence: on hybrid systems there are no controllers
behind it.
"""

import os

from .system_files import read_text

_NO_LIMIT = 1 << 60


class CgroupLimit:
    """Limit of a control group: ``value`` cores or bytes for the group at ``folder`` of hierarchy ``version``
    (1 or 2).
    """

    __slots__ = ("folder", "value", "version")

    def __init__(self, value: float, folder: str, version: int) -> None:
        self.value, self.folder, self.version = value, folder, version


def list_groups(root: str, controller: str, process: str = "self") -> "list[tuple[str, int]]":
    """List (directory, version) from the group of a process (the agent's own) up to the top of the hierarchy
    that has ``controller``.
    """
    v2_path = ""
    for line in read_text("%s/proc/%s/cgroup" % (root, process)).splitlines():
        number, _, rest = line.partition(":")
        names, _, path = rest.partition(":")
        if controller in names.split(","):
            mount = "%s/sys/fs/cgroup/%s" % (root, names)
            return _list_ancestors(
                mount if os.access(mount, os.F_OK) else "%s/sys/fs/cgroup/%s" % (root, controller), path, 1
            )
        if number == "0" and not names:
            v2_path = path
    for mount in (root + "/sys/fs/cgroup", root + "/sys/fs/cgroup/unified"):
        if controller in read_text(mount + "/cgroup.controllers").split():
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
        quota, _, period = read_text(folder + "/cpu.max").partition(" ")
    else:
        quota, period = read_text(folder + "/cpu.cfs_quota_us"), read_text(folder + "/cpu.cfs_period_us")
    if not quota.isdigit() or not period.isdigit() or not int(period):
        return 0.0
    return int(quota) / int(period)


def is_v2(root: str = "") -> bool:
    """Whether all controllers are in the one hierarchy of version 2."""
    return os.access(root + "/sys/fs/cgroup/cgroup.controllers", os.F_OK)


def find_cpu_limit(root: str = "") -> "CgroupLimit | None":
    """Find the smallest CPU quota (cores) of the agent's group and its ancestors.

    None where there is none.
    """
    found = [
        CgroupLimit(_read_cpu_quota(folder, version), folder, version)
        for folder, version in list_groups(root, "cpu")
    ]
    return min((limit for limit in found if limit.value > 0), key=lambda limit: limit.value, default=None)


def find_memory_limit(root: str = "") -> "CgroupLimit | None":
    """Find the smallest memory limit (bytes) of the agent's group and its ancestors.

    None where there is none.
    """
    found = []
    for folder, version in list_groups(root, "memory"):
        text = read_text(folder + ("/memory.max" if version == 2 else "/memory.limit_in_bytes"))
        if text.isdigit() and 0 < int(text) < _NO_LIMIT:
            found.append(CgroupLimit(int(text), folder, version))
    return min(found, key=lambda limit: limit.value, default=None)
