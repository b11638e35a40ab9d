# SPDX-License-Identifier: Apache-2.0
"""Operation ``graph``: the nodes of a running ROS graph, each with the process that it is on this host.

Nothing is started but, for ROS 2, the helper that answers questions to the graph.
"""

import time

from ..link import protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document, dumps
from ..measure import detection, proc, system_files
from ..supervise import liveness, shell
from .local import fill_request, list_setup_files

# A reply has room for so many characters of nodes.
_MOST_CHARS = 600_000
_MOST_WORDS_CHARS = 1000
# The path of a log differs from start to start, and so does what roslaunch writes after it.
_LOG_WORD = "__log:="
_NO_MASTER_HINT = "state ros: {version: 1, master: ..} in the inventory, and start roscore"


def describe_graph(request: Document) -> Document:
    """List the nodes of the graph.

    Raises:
        RefusalError: no master or no helper answers.
    """
    shell.install_deadline_handlers()
    request = fill_request(dict(request, command=""))
    nodes = _list_nodes(request, time.monotonic() + float(request["timeout_s"]))
    table = proc.read_process_table()
    cmdlines, ours = _read_cmdlines(table)
    answer = []  # type: list[Document]
    room = _MOST_CHARS
    for node in nodes:
        described = dict(node, **_describe_process(node, cmdlines, ours, table))
        room -= len(dumps(described))
        if room < 0:
            break
        answer.append(described)
    return {
        "v": protocol.VERSION,
        "op": protocol.OP_GRAPH,
        "host": request["host"],
        "nodes": answer,
        "left_out": len(nodes) - len(answer),
    }


def _list_nodes(request: Document, deadline: float) -> "list[Document]":
    env, setup = request.get("env") or {}, list_setup_files(request)
    if request["version"] == 2:
        from . import graph2, nodes2

        graph2.ensure_helper(request["host"], env, setup)
        try:
            return nodes2.list_nodes(env, setup, deadline)
        except graph2.NoHelperError as error:
            raise RefusalError("no-graph", str(error), "state ros: {setup: [..]} in the inventory") from error
    from . import nodes1, xmlrpc

    try:
        return nodes1.list_nodes(env.get("ROS_MASTER_URI", ""), deadline)
    except xmlrpc.CallError as error:
        raise RefusalError("no-graph", str(error), _NO_MASTER_HINT) from error


def _read_cmdlines(table: "dict[int, proc.Process]") -> "tuple[dict[int, list[str]], dict[int, list[str]]]":
    """Read (the command lines of the processes that ``detect`` may find, those of the tasks of edgectl)."""
    above = detection.find_own_ancestors(table)
    read = {pid: proc.read_cmdline(pid) for pid in table if pid not in above}
    read = {pid: argv for pid, argv in read.items() if argv[0]}
    ours = {pid: argv for pid, argv in read.items() if liveness.has_cookie(pid)}
    return {pid: argv for pid, argv in read.items() if pid not in ours}, ours


def _describe_process(
    node: Document,
    cmdlines: "dict[int, list[str]]",
    ours: "dict[int, list[str]]",
    table: "dict[int, proc.Process]",
) -> Document:
    """Describe the process of a node, and how ``detect`` would find it.

    ``task``: FLEET/HOST/TASK of the task to which it belongs; ``words``: the part of its command line that
    stays from start to start; ``named``: its name finds it and nothing else; ``alike``: how many others
    have the same words.
    """
    pid, rule = int(node["pid"]), {"ros_node": str(node["name"])}
    pids = detection.find_matches(rule, cmdlines, table) if node["name"] else set()
    if not pid and node["here"] is not False:
        likely = pids or detection.find_matches(rule, ours, table)
        pid = next(iter(likely)) if len(likely) == 1 else 0
    words = _cut_words(cmdlines.get(pid) or [])
    others = set(cmdlines) - proc.find_descendants({pid}, table)
    return {
        "pid": pid,
        "task": _read_task(pid) if pid in ours else "",
        "words": words,
        "named": len(pids) == 1 and pid in proc.find_descendants(pids, table),
        "alike": sum(_cut_words(cmdlines[other])[: len(words)] == words for other in others) if words else 0,
    }


def _read_task(pid: int) -> str:
    """Read which task a process belongs to; empty for none."""
    mark = b"EDGECTL_TASK_DIR="
    for entry in system_files.read_file("/proc/%d/environ" % pid).split(b"\0"):
        if entry.startswith(mark):
            parts = entry[len(mark) :].decode("utf-8", "replace").split("/")
            return "/".join((parts[-5], parts[-3], parts[-1])) if len(parts) >= 5 else "?"
    return ""


def _cut_words(argv: "list[str]") -> "list[str]":
    """Cut a command line before what differs from start to start, and to a bounded length."""
    kept, room = [], _MOST_WORDS_CHARS
    for word in argv:
        room -= len(word) + 1
        if word.startswith(_LOG_WORD) or room < 0 or not word.isprintable():
            break
        kept.append(word)
    return kept
