"""The keys of the task files and how each is read."""

import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from edgectl.config.fields import argument_vector, as_node, environment, items, labels, read_fields, record
from edgectl.config.node import Node, plain
from edgectl.config.problems import Code, Mark, Problems
from edgectl.config.scalars import INVALID, Read, amount, flag, integer, name, text, version, word, wrong_type
from edgectl.config.units import demand_parser, parse_cost, parse_margin
from edgectl.model.policy import PolicyName, SequenceRule
from edgectl.model.task import (
    Check,
    Demand,
    Detect,
    Handoff,
    HandoffOrder,
    Kind,
    Log,
    Need,
    Onboard,
    OnUnreachable,
    Quantity,
    Restart,
    Stop,
    TaskLimits,
    Until,
    Where,
)
from edgectl.model.weights import parse_weights
from edgectl.units import parse_bytes, parse_cores, parse_duration, parse_rate

_SIGNALS = ("TERM", "INT", "HUP", "QUIT", "KILL", "USR1", "USR2")
_DURATION = amount(parse_duration, above_zero=True)
MEASURED_WORD, MEASURED = "measured", Quantity(value=0.0, measured=True)


def _check(where: Where) -> Read:
    """A check: its command alone, or a mapping. ``where`` it runs unless it says so."""
    mapping = record(CHECK, Check, "a check", ("command",))

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if isinstance(node.value, str):
            command = text(node, problems)
            return command if command is INVALID else Check(command=command, on=where)
        check = mapping(node, problems)
        stated = isinstance(node.value, dict) and "on" in node.value
        return check if check is INVALID or stated else replace(check, on=where)

    return read


def _need(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if isinstance(node.value, dict):
        return record(NEED, Need, "a need", ("task",))(node, problems)
    task = name(node, problems)
    return task if task is INVALID else Need(task=task)


def _signal(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if node.value in _SIGNALS:
        return node.value
    problems.add(
        node.mark, Code.WORD, f"unknown signal {node.text!r}", problems.did_you_mean(node.text.upper().removeprefix("SIG"), _SIGNALS)
    )
    return INVALID


def _stop(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if node.value == "ros":
        return Stop(signal="INT", preset="ros")
    if isinstance(node.value, dict):
        stop = record(STOP, Stop, "stop")(node, problems)
        ros = stop is not INVALID and stop.preset == "ros" and "signal" not in node.value
        return replace(stop, signal="INT") if ros else stop
    problems.add(node.mark, Code.WORD, f"unknown way to stop: {node.text or '?'}", "write ros, or {signal: TERM, grace: 20s}")
    return INVALID


def _preset(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if node.value == "ros":
        return "ros"
    problems.add(node.mark, Code.WORD, f"unknown preset {node.text!r}", "write ros, or remove preset")
    return INVALID


def _regex(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    value = text(node, problems)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # Python's own plans for "[[" are nothing to whoever runs edgectl
            re.compile(value) if isinstance(value, str) else None
    except (re.error, OverflowError, RecursionError) as error:
        hint = f"escape it to mean the characters themselves: '{re.escape(str(value))}'"
        problems.add(node.mark, Code.REGEX, f"not a regular expression: {error}", hint)
        return INVALID
    return value


def _unreachable(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if isinstance(node.value, dict):
        fields = read_fields(node, problems, ON_UNREACHABLE, required=("policy",), what="on_unreachable")
        policy = fields.values.get("policy", INVALID)
        return INVALID if policy is INVALID else (policy, fields.values.get("after"))
    policy = word(OnUnreachable)(node, problems)
    return policy if policy is INVALID else (policy, None)


def _robots(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    return "all" if node.value == "all" else items(name)(node, problems)


def _for_each(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if isinstance(node.value, list) and node.value:
        return items(name)(node, problems)
    if node.value == "robot":
        return "all"
    return wrong_type(node, problems, "must be the word robot, or a list of robots", "write for_each: robot")


def _priority(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    value = node.value
    if isinstance(value, bool) or not isinstance(value, int | float):
        return wrong_type(node, problems, "must be a number", "write 10, or -1; high goes first")
    if not abs(value) <= 1e9:
        problems.add(node.mark, Code.QUANTITY, f"must be a finite number, not {node.text}", "write a number between -1e9 and 1e9")
        return INVALID
    return float(value)


def _host_rules(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    return read_fields(node, problems, HOST_RULES, what="hosts")


def _weights(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    try:
        return parse_weights(plain(node))
    except ValueError as error:
        message, _, hint = str(error).partition("; ")
        problems.add(_blamed(node, message), Code.QUANTITY, message, hint)
        return INVALID


def _blamed(node: Node, message: str) -> Mark:
    """Where the weight stands that ``message`` names."""
    for key, inner in node.value.items() if isinstance(node.value, dict) else ():
        if message == f"unknown weight {key!r}":
            return node.key_mark(key)
        if message.startswith(f"weight {key} "):
            return inner.mark
    return node.mark


def _demand(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    if node.value == MEASURED_WORD:
        return Demand(cpu=MEASURED, memory=MEASURED, throughput=MEASURED)
    return record(DEMAND, Demand, "demand")(node, problems)


def _rho(parse: Callable[[object], Quantity]) -> Read:
    """One demand: a quantity, the word ``measured``, or a quantity that counts until then."""
    quantity = amount(parse)

    def read(node: Node, problems: Problems) -> Any:  # noqa: ANN401
        if node.value == MEASURED_WORD:
            return MEASURED
        if isinstance(node.value, str) and node.value.isalpha():
            hint = problems.did_you_mean(node.value, [MEASURED_WORD], "write a quantity, or")
            problems.add(node.mark, Code.WORD, f"unknown word {node.value!r}", hint)
            return INVALID
        if not isinstance(node.value, dict):
            return quantity(node, problems)
        until = record({"until_measured": quantity}, _until, "a measured demand", ("until_measured",))
        return until(node, problems)

    return read


def _until(*, until_measured: Quantity) -> Quantity:
    return replace(until_measured, measured=True)


def _max_moves(node: Node, problems: Problems) -> Any:  # noqa: ANN401
    return None if node.value == "unlimited" else integer(0, 1_000_000)(node, problems)


CHECK: Mapping[str, Read] = {"command": text, "on": word(Where), "timeout": _DURATION}
NEED: Mapping[str, Read] = {"task": name, "until": word(Until)}
DEMAND: Mapping[str, Read] = {
    "cpu": _rho(demand_parser(parse_cores, "1.5")),
    "memory": _rho(demand_parser(parse_bytes, "900Mi")),
    "throughput": _rho(demand_parser(parse_rate, "12MB/s")),
}
HOST_RULES: Mapping[str, Read] = {"only": items(name), "never": items(name), "labels": labels, "pin": name}
DETECT: Mapping[str, Read] = {"cmdline": _regex, "ros_node": text}
STOP: Mapping[str, Read] = {"signal": _signal, "grace": amount(parse_duration), "preset": _preset}
HANDOFF: Mapping[str, Read] = {
    "order": word(HandoffOrder),
    "safe_when": _check(Where.ROBOT),
    "hold": _check(Where.ROBOT),
    "release": _check(Where.ROBOT),
    "timeout": _DURATION,
}
TASK_LIMITS: Mapping[str, Read] = {"cpu": amount(parse_cores, above_zero=True), "memory": amount(parse_bytes, above_zero=True)}
LOG: Mapping[str, Read] = {"max_size": amount(parse_bytes, above_zero=True), "files": integer(1, 100)}
ON_UNREACHABLE: Mapping[str, Read] = {"policy": word(OnUnreachable), "after": _DURATION}
TASK: Mapping[str, Read] = {
    "command": text,
    "for_each": _for_each,
    "robot": name,
    "robots": _robots,
    "needs": items(_need),
    "demand": _demand,
    "priority": _priority,
    "deadline": _DURATION,
    "hosts": _host_rules,
    "onboard": word(Onboard),
    "kind": word(Kind),
    "managed": flag,
    "detect": record(DETECT, Detect, "detect"),
    "ready": _check(Where.HOST),
    "done_when": _check(Where.HOST),
    "stop": _stop,
    "restart": word(Restart),
    "handoff": record(HANDOFF, Handoff, "handoff"),
    "env": environment,
    "env_command": argument_vector,
    "workdir": text,
    "limits": record(TASK_LIMITS, TaskLimits, "limits"),
    "log": record(LOG, Log, "log"),
    "on_unreachable": _unreachable,
    "self_fence": _DURATION,
    "downtime_cost": amount(parse_cost),
    "labels": labels,
}
POLICY: Mapping[str, Read] = {
    "policy": word(PolicyName),
    "weights": _weights,
    "sequence": word(SequenceRule),
    "move_margin": amount(parse_margin),
    "min_dwell": amount(parse_duration),
    "max_moves": _max_moves,
}
TASKS: Mapping[str, Read] = {"version": version, **POLICY, "tasks": as_node}
