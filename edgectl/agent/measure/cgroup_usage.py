# SPDX-License-Identifier: Apache-2.0
"""Usage of the control groups of hosts with a limit and of containers; ``root`` is another tree in tests."""

import os

from .cgroup import CgroupLimit, list_groups
from .system_files import read_text


def _read_numbers(path: str) -> "dict[str, int]":
    """Read lines ``name value``."""
    pairs = (line.split() for line in read_text(path).splitlines())
    return {pair[0]: int(pair[1]) for pair in pairs if len(pair) == 2 and pair[1].isdigit()}


def read_cpu_used_s(limit: CgroupLimit, root: str = "") -> float:
    """Read the CPU seconds that the limited group has used; -1 where its accounting cannot be read."""
    if limit.version == 2:
        used = _read_numbers(limit.folder + "/cpu.stat").get("usage_usec")
        return -1.0 if used is None else used / 1e6
    # The quota may be in hierarchy ``cpu`` and the accounting in ``cpuacct``, under the same path.
    below = limit.folder[len(root + "/sys/fs/cgroup/") :].partition("/")[2]
    for mount in ("cpuacct", "cpu,cpuacct", "cpuacct,cpu"):
        text = read_text("%s/sys/fs/cgroup/%s/%s/cpuacct.usage" % (root, mount, below))
        if text.isdigit():
            return int(text) / 1e9
    return -1.0


def read_container_cpu_s(pid: int, root: str = "") -> float:
    """Read the CPU seconds of the control group of a container with process ``pid``, since it was created; -1
    where that cannot be read.
    """
    # Version 1 counts in cpuacct, which need not be where the quota is.
    for controller in ("cpuacct", "cpu"):
        for folder, version in list_groups(root, controller, str(pid))[:1]:
            return read_cpu_used_s(CgroupLimit(0.0, folder, version), root)
    return -1.0


def read_container_memory(pid: int, root: str = "") -> int:
    """Read the bytes of the control group of a container with process ``pid``, as `read_memory_used`; -1
    where that cannot be read.
    """
    for folder, version in list_groups(root, "memory", str(pid))[:1]:
        name = "memory.current" if version == 2 else "memory.usage_in_bytes"
        if os.access(folder + "/" + name, os.F_OK):
            return read_memory_used(CgroupLimit(0.0, folder, version))
    return -1


def read_memory_used(limit: CgroupLimit) -> int:
    """Read the bytes in use in the limited group without reclaimable page cache.

    Shared memory counts as used.
    """
    folder = limit.folder
    numbers = _read_numbers(folder + "/memory.stat")
    if limit.version == 2:
        used, cache = read_text(folder + "/memory.current"), numbers.get("file", 0) - numbers.get("shmem", 0)
    else:
        used = read_text(folder + "/memory.usage_in_bytes")
        cache = numbers.get("total_cache", 0) - numbers.get("total_shmem", 0)
    return max(0, int(used or 0) - max(0, cache))
