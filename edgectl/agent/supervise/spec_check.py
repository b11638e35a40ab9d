# SPDX-License-Identifier: Apache-2.0
"""Checks of a spec, run by its supervisor: by command, or by a question to the ROS graph."""

from ..link.fast_json import Document
from . import shell

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping, Union

    from ..ros.question import GraphQuestion

    RunningCheck = Union[shell.ShellCommand, GraphQuestion]


# It has room in the record of a status.
_MAX_FAULT = 300


def start_check(check: Document, spec: Document, env: "Mapping[str, str]", most_s: float) -> "RunningCheck":
    """Start a check, for at most ``most_s`` and its own timeout."""
    limit = min(most_s, float(check.get("timeout_s") or most_s))
    # Imported on demand: tasks without checks need neither questions nor subprocess.
    from ..ros.question import start_question

    return start_question(check, spec, env, limit, shell.resolve_workdir(spec.get("workdir"), env))


def build_ready_rule(spec: Document) -> Document:
    """Build the ready check of a spec: only the new instance is to answer it, not one that it replaces."""
    rule: Document = spec["ready"]
    if not rule.get("graph"):
        return rule
    return dict(rule, graph=dict(rule["graph"], starting=True, replaces=spec.get("replaces")))


def describe_fault(check: Document, result: Document) -> str:
    """Describe why a check failed: the words of the graph, or the end of a command."""
    if check.get("graph"):
        return str(result["output"])[:_MAX_FAULT]
    if result["timed_out"]:
        return "its check did not end in time"
    return "its check ended with %s" % result["exit"]
