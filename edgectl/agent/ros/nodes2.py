# SPDX-License-Identifier: Apache-2.0
"""Nodes of a running graph of ROS 2, as the helper sees them, and their processes.

The graph does not state processes; the ids of Fast DDS do.
"""

import re

from ..link import fast_json
from ..link.fast_json import Document
from ..measure import proc
from . import graph2, participants

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping

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
        raise graph2.NoHelperError(answer or graph2.OLD_HELPER)
    graph = fast_json.loads(answer)
    own = str(graph["nodes"][graph["own"]]["gid"])
    known = participants.is_of_process(own, int(graph["pid"]))
    processes = [pid for pid in proc.read_process_table() if participants.has_fast_dds(pid)] if known else []
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


def _find_process(gid: str, own: str, processes: "list[int]") -> Document:
    """Find the process of a participant; ``own``: the id of the helper, empty where it says nothing."""
    found = {"address": "", "here": None, "pid": 0, "fault": ""}  # type: Document
    if own and participants.is_fast_dds(gid):
        found["here"] = participants.is_same_host(gid, own)
        pids = [pid for pid in processes if found["here"] and participants.is_of_process(gid, pid)]
        found["pid"] = pids[0] if len(pids) == 1 else 0
    return found
