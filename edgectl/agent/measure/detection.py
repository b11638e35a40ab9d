# SPDX-License-Identifier: Apache-2.0
"""Rules that find the processes of an unmanaged task: a pattern of its command line, or its ROS node."""

import os

from ..link.fast_json import Document
from . import proc, system_files

_NAME_WORDS = ("__name:=", "__node:=")
_SPACE_WORD = "__ns:="


def is_match(rule: Document, pid: int, argv: "list[str]") -> bool:
    """Whether a process is one that the rule of a request means."""
    if rule.get("ros_node"):
        return is_ros_node(str(rule["ros_node"]), pid, argv)
    import re

    return bool(rule.get("cmdline")) and re.search(str(rule["cmdline"]), " ".join(argv)) is not None


def is_ros_node(name: str, pid: int, argv: "list[str]") -> bool:
    """Whether the process is the ROS node ``name``: by its command line, else by the name of its program.

    A name that begins with a slash is a full one: the namespace of the process must be its namespace.
    """
    namespace, _, short = name.rpartition("/")
    if not _has_node_name(short, argv):
        return False
    return not name.startswith("/") or _read_namespace(pid, argv) in (namespace or "/", None)


def _has_node_name(node: str, argv: "list[str]") -> bool:
    stated = [word[word.index(mark) + len(mark) :] for word in argv for mark in _NAME_WORDS if mark in word]
    if stated:
        return node in stated
    # The program, or the script that an interpreter runs.
    return not {"name:=" + node, "node:=" + node}.isdisjoint(argv) or any(
        os.path.splitext(os.path.basename(word))[0] == node for word in argv[:2]
    )


def _read_namespace(pid: int, argv: "list[str]") -> "str | None":
    """Read the namespace in which a process was started; None where that cannot be seen."""
    stated = [word.partition(_SPACE_WORD)[2] for word in argv if _SPACE_WORD in word]
    if not stated:
        environ = system_files.read_file("/proc/%d/environ" % pid)
        if not environ:
            return None
        begins = b"ROS_NAMESPACE="
        stated = [os.fsdecode(each[len(begins) :]) for each in environ.split(b"\0") if each[:14] == begins]
    return "/" + stated[-1].strip("/") if stated else "/"


def find_matches(
    rule: Document, cmdlines: "dict[int, list[str]]", table: "dict[int, proc.Process]"
) -> "set[int]":
    """Find the topmost processes among ``cmdlines`` that the rule means: what is below one belongs to it."""
    pids = {pid for pid, argv in cmdlines.items() if is_match(rule, pid, argv)}
    return {pid for pid in pids if table[pid].ppid not in pids}


def find_own_ancestors(table: "dict[int, proc.Process]") -> "set[int]":
    """Find the agent and its ancestors: the command line of a login shell or sshd may match a pattern too."""
    found: "set[int]" = set()
    pid = os.getpid()
    while pid in table and pid not in found:
        found.add(pid)
        pid = table[pid].ppid
    return found
