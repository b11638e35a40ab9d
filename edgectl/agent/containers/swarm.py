# SPDX-License-Identifier: Apache-2.0
"""Calls to the managers of a Docker Swarm, and the proof that the service of a task starts nothing any more.

A swarm starts a service at any time after it was asked for it, also when its node comes back after days. It
starts none twice (``--restart-condition none``, one node): so a service whose container has run is over once
that has ended, whatever becomes of the managers; one whose container was not seen yet is *pending* until a
manager has removed it, and its tasks have ended.
"""

import time

from ..link import fast_json
from ..link.fast_json import Document
from ..measure import proc, system_files
from . import engine, record, service

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping, Sequence

# A manager gives up a request after 20 s, even if nobody waits for its answer any more.
REQUEST_S = 30.0
_ANSWER_S = 21.0
_REMOVE_S, _TASKS_S, _POLL_S, _DESCRIBE_S = 25.0, 20.0, 0.3, 8.0
_NO_ANSWER = (
    *("not a swarm manager", "leader", "deadline", "unavailable", "timeout", "timed out"),
    *("unable to resolve docker endpoint", "permission denied"),
)
_NO_MANAGER = "no manager of the swarm answers"
NOT_A_NODE = "the engine of this host is in no swarm"


def read_node(program: str) -> "tuple[engine.EngineCall, Document]":
    """Ask the engine of this host for its part in a swarm: ``NodeID`` and ``LocalNodeState``."""
    call = engine.call_engine([program, "info", "--format", "{{json .Swarm}}"])
    if call.kind != engine.DONE:
        return call, {}
    try:
        return call, dict(fast_json.loads(call.out.strip()))
    except ValueError:
        return engine.EngineCall(engine.FAILED, "", "the state of the swarm cannot be read"), {}


def describe_swarm(managers: "Sequence[str]") -> "dict[str, Document]":
    """Describe this node as an engine: ``version``, its part in the swarm, or the ``error`` for which it runs
    no service. Empty without docker.
    """
    program = engine.find_program("docker")
    if not program:
        return {}
    call, found = read_node(program)
    if call.kind != engine.DONE:
        return {engine.SWARM: {"error": call.why}}
    if found.get("LocalNodeState") != "active":
        return {engine.SWARM: {"error": NOT_A_NODE}}
    call = call_managers(program, ["", *managers], ["node", "ls", "--quiet"], _DESCRIBE_S)
    if call.kind != engine.DONE:
        return {engine.SWARM: {"error": call.why}}
    return {engine.SWARM: {"version": "manager" if found.get("ControlAvailable") else "worker"}}


def call_managers(
    program: str,
    managers: "Sequence[str]",
    words: "Sequence[str]",
    timeout_s: float = engine.CALL_S,
    env: "Mapping[str, str] | None" = None,
    keep: "tuple[int, ...]" = (),
) -> engine.EngineCall:
    """Call ``managers``, contexts of docker, until one answers; an empty one is the engine of this host.

    LOST where none does, with the reason of the last one.
    """
    last = engine.EngineCall(engine.LOST, "", _NO_MANAGER)
    for context in managers:
        argv = [program, *(["--context", context] if context else []), *words]
        call = engine.call_engine(argv, timeout_s, env, keep)
        if call.kind != engine.LOST and not _is_no_answer(call):
            return call
        last = engine.EngineCall(engine.LOST, call.out, "%s: %s" % (_NO_MANAGER, call.why))
    return last


def _is_no_answer(call: engine.EngineCall) -> bool:
    """Whether the failure is that of an engine which is no manager, or of one that knows no leader."""
    words = call.why.lower()
    return call.kind == engine.FAILED and any(each in words for each in _NO_ANSWER)


def list_services(
    program: str, managers: "Sequence[str]", place: str
) -> "tuple[list[str], engine.EngineCall]":
    """List the ids of the services of a task on this node."""
    words = ["service", "ls", "--quiet", "--filter", "label=%s=%s" % (service.PLACE_LABEL, place)]
    call = call_managers(program, managers, words)
    return call.out.split() if call.kind == engine.DONE else [], call


def is_name_taken(why: str) -> bool:
    """Whether a service could not be created because there is one of its name."""
    return "name conflicts" in why or "already exists" in why.lower()


def find_service_fault(program: str, managers: "Sequence[str]", name: str) -> str:
    """Find why the swarm does not start the service; empty while it may start still."""
    words = ["service", "ps", "--no-trunc", "--format", "{{.CurrentState}}|{{.Error}}", name]
    call = call_managers(program, managers, words)
    state, _, error = call.out.strip().partition("|")
    ended = state.lower().startswith(("rejected", "failed", "orphaned"))
    return error.strip('"') or state if call.kind == engine.DONE and ended else ""


def describe_wait(program: str, managers: "Sequence[str]", name: str) -> str:
    """Describe what the swarm waits for before it starts the service, as far as it says."""
    words = ["service", "ps", "--no-trunc", "--format", "{{.CurrentState}} {{.Error}}", name]
    call = call_managers(program, managers, words)
    return " ".join(call.out.split())[:200] if call.kind == engine.DONE else call.why


def remove_service(folder: str) -> str:
    """Remove the service of the task in ``folder``: empty with proof that it starts nothing on this host any
    more, else why that is not known.

    Where its container has run and no manager answers, the service itself is left for a later stop or start.
    """
    found = record.read_container(folder)
    if not found.get("place"):
        return ""
    program, managers = str(found["program"]), [str(each) for each in found["managers"]]
    _await_answer(found)
    ids, call = list_services(program, managers, str(found["place"]))
    if found.get("pending") and call.kind == engine.DONE and not ids:
        ids, call = _list_for_sure(found, managers)
    known = sorted({*ids, *(found.get("services") or [])})
    if ids:
        found = dict(found, services=known)
        record.write_container(folder, found, durable=True)
        call = call_managers(program, managers, ["service", "rm", *ids], _REMOVE_S)
    why = "" if call.kind in (engine.DONE, engine.GONE) else call.why
    if found.get("pending"):
        why = why or _await_end_of_tasks(program, managers, str(found["place"]), known)
        if why and not _has_left(program, str(found["place"])):
            return "%s; its service may still start here" % why
    elif why:
        return ""
    record.write_container(folder, dict(found, place="", services=[], pending=False), durable=True)
    return ""


def _list_for_sure(found: Document, managers: "Sequence[str]") -> "tuple[list[str], engine.EngineCall]":
    """List the services as the quorum of the managers has them, one without a container among them.

    A manager that has lost the others may not know of a service, or have one in its log that is agreed on
    later. So a service of the same name is created first, which only a quorum can, and of which there is only
    one.
    """
    words = ["service", "create", "--detach", "--quiet", "--no-resolve-image", "--replicas", "0"]
    words += ["--name", str(found["service"]), "--label", "%s=%s" % (service.PLACE_LABEL, found["place"])]
    call = call_managers(str(found["program"]), managers, [*words, str(found["image"])], REQUEST_S)
    # Where a service has the name, that is this task's, which is listed now, or a foreign one.
    if call.kind != engine.DONE and not is_name_taken(call.why):
        return [], engine.EngineCall(engine.LOST, "", call.why)
    return list_services(str(found["program"]), managers, str(found["place"]))


def _has_left(program: str, place: str) -> bool:
    """Whether this host has left the swarm for which a service was meant, and is not that node any more."""
    call, found = read_node(program)
    return call.kind == engine.DONE and found.get("NodeID") != place.partition(":")[0]


def _await_answer(found: Document) -> None:
    """Wait until the request for the service was answered, where nobody has heard the answer."""
    if found.get("pending") and not found.get("services"):
        asked = float(found["asked"]) if found.get("boot_id") == system_files.read_boot_id() else 0.0
        time.sleep(min(_ANSWER_S, max(0.0, asked + _ANSWER_S - proc.read_uptime_s())))


def _await_end_of_tasks(
    program: str, managers: "Sequence[str]", place: str, services: "Sequence[str]"
) -> str:
    """Wait until this node has ended the tasks of services that were removed: empty, else why not."""
    deadline = time.monotonic() + _TASKS_S
    node = place.partition(":")[0]
    words = ["node", "ps", "--no-trunc", "--format", "{{.Name}}", node]
    while services:
        call = call_managers(program, managers, words)
        if call.kind != engine.DONE:
            return call.why
        if not any(line.startswith(tuple(services)) for line in call.out.split()):
            break
        if time.monotonic() > deadline:
            return "the swarm has not ended its task on this node yet"
        time.sleep(_POLL_S)
    return ""
