# SPDX-License-Identifier: Apache-2.0
"""Files of /proc and /sys, and what identifies a host in them.

A module of its own: each probe reads such files, and few hosts' tasks need the process table of ``proc.py``.
"""

import os

TICKS_PER_S = os.sysconf("SC_CLK_TCK")

_BLOCK = 1 << 16


def read_file(path: str) -> bytes:
    """Read a file; empty where it is gone or unreadable.

    Takes two thirds of ``open``: whole process tables are read with it.
    """
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return b""
    try:
        parts = [os.read(fd, _BLOCK)]
        while parts[-1]:
            parts.append(os.read(fd, _BLOCK))
        return b"".join(parts)
    except OSError:
        return b""
    finally:
        os.close(fd)


def read_text(path: str) -> str:
    """Read a file of one value; empty where there is none."""
    return read_file(path).decode("ascii", "replace").strip()


def list_folder(folder: str, part: str = "") -> "list[str]":
    """List the paths in ``folder`` with ``part`` in their names."""
    try:
        return sorted(folder + "/" + name for name in os.listdir(folder) if part in name)
    except OSError:
        return []


def read_boot_id() -> str:
    """Read the id of this boot of the host."""
    return read_file("/proc/sys/kernel/random/boot_id").decode().strip()


def read_machine_id() -> str:
    """Read the id of the installation; empty where it has none, as in many containers."""
    return read_file("/etc/machine-id").decode("ascii", "replace").strip()


def read_pid_namespace() -> str:
    """Read the id of the processes that this login sees; empty where the kernel does not tell."""
    try:
        return os.readlink("/proc/self/ns/pid")
    except OSError:
        return ""
