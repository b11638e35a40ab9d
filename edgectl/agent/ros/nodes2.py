"""Nodes of a running graph of ROS 2, as the helper sees them, and their processes.

The graph does not state processes. The id of a Fast DDS participant holds the vendor, the host and the lower
half of the process id; that this is so here is read off the id of the helper, whose process is known.
"""

import re

from ..link import fast_json
from ..link.fast_json import Document
from ..measure import proc
from . import graph2

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping

_FAST_DDS = "010f"
_ENDS_OF_HOST, _ENDS_OF_PID = 8, 12
_LIBRARY = re.compile(rb"/libfast(rtps|dds)[.-]")
# Helpers of edgectl, and what the tools of ROS 2 leave behind.
_OWN_NAME = re.compile("/edgectl_[0-9]+|.*/_[^/]*")


def list_nodes(env: "Mapping[str, str]", setup: "list[str]", deadline: float) -> "list[Document]":
    """List the nodes, with the keys of ``nodes1.list_nodes``.

    ``here`` is None where it is not known whether a node runs on this host.

    Raises:
        NoHelperError: there is no helper, or none that answers.
    """
    helper = graph2.build_helper_name(env, setup)
    answer = graph2.ask_helper(helper, {"list": True}, deadline, graph2.CONNECT_S)
    if not answer.startswith("{"):
        raise graph2.NoHelperError(
            answer or "the helper for ROS 2 is of another edgectl; try again in a minute"
        )
    graph = fast_json.loads(answer)
    own = str(graph["nodes"][graph["own"]]["gid"])
    known = _is_of_process(own, int(graph["pid"]))
    processes = _list_participants() if known else []
    return [
        dict(
            _find_process(str(node["gid"]), own if known else "", processes),
            name=name,
            publishes=sorted(node["publishes"]),
            subscribes=sorted(node["subscribes"]),
        )
        for name, node in sorted(graph["nodes"].items())
        if not _OWN_NAME.fullmatch(name)
    ]


def _is_of_process(gid: str, pid: int) -> bool:
    """Whether the id is one of Fast DDS, and of this process."""
    text = gid[_ENDS_OF_HOST:_ENDS_OF_PID]
    return gid.startswith(_FAST_DDS) and int(text[2:] + text[:2], 16) == pid & 0xFFFF


def _list_participants() -> "list[int]":
    """List the processes that have loaded Fast DDS, as far as this user may see that."""
    return [
        pid for pid in proc.read_process_table() if _LIBRARY.search(proc.read_file("/proc/%d/maps" % pid))
    ]


def _find_process(gid: str, own: str, processes: "list[int]") -> Document:
    """Find the process of a participant; ``own``: the id of the helper, empty where it says nothing."""
    found = {"address": "", "here": None, "pid": 0, "fault": ""}  # type: Document
    if own and gid.startswith(_FAST_DDS):
        found["here"] = gid[:_ENDS_OF_HOST] == own[:_ENDS_OF_HOST]
        pids = [pid for pid in processes if found["here"] and _is_of_process(gid, pid)]
        found["pid"] = pids[0] if len(pids) == 1 else 0
    return found
