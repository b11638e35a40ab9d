# SPDX-License-Identifier: Apache-2.0
"""Rules between the keys of a task, and between a task and the inventory."""

import re

from edgectl.config.fields import Fields
from edgectl.config.host_rules import FleetIndex
from edgectl.config.node import Node
from edgectl.config.placeholders import PLACEHOLDER_KEYS, has_placeholder
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.task_file import EXCLUSIVE_KEYS, TASK_KEYS, TaskDraft, TaskTemplate
from edgectl.model.check import Check, CheckLocation, OnUnhealthy
from edgectl.model.demand import Demand
from edgectl.model.image import ContainerEngine
from edgectl.model.latency import HeardRule, LatencyRule
from edgectl.model.resource import RESOURCES
from edgectl.model.task import HandoffOrder, OnboardRule, RestartPolicy, TaskKind, UnreachablePolicy
from edgectl.names import suggest_name
from edgectl.units import format_duration

# Heartbeats leave every quarter of self_fence, and those of one second count as one on the manager's disk.
MIN_SELF_FENCE_S = 4.0

_TRAILING_AMPERSAND = re.compile(r"(?<![&>|\\])&\s*$")


def check_template(template: TaskTemplate, problems: Problems) -> None:
    """Contradictions within one entry."""
    fields = template.fields
    _check_exclusive_keys(fields, problems)
    if fields.values.get("managed", True):
        _check_managed(template, problems)
    else:
        _check_unmanaged(template, problems)


def _check_exclusive_keys(fields: Fields, problems: Problems) -> None:
    for one, other in EXCLUSIVE_KEYS:
        if one in fields and other in fields:
            message = f"{one} and {other} do not go together"
            problems.add(
                fields.node.key_mark(other), ProblemCode.CONTRADICTION, message, f"remove {other} or {one}"
            )


def _check_managed(template: TaskTemplate, problems: Problems) -> None:
    fields = template.fields
    if "command" not in fields and "image" not in fields and isinstance(fields.node.value, dict):
        hint = "add command: .., image: .., or managed: false with detect:"
        problems.add(template.named_at, ProblemCode.MISSING, f"task {template.name} needs command", hint)
    if "detect" in fields:
        message = "detect finds tasks that edgectl does not start, and this one it does"
        problems.add(
            fields.node.key_mark("detect"),
            ProblemCode.CONTRADICTION,
            message,
            "remove detect, or write managed: false and remove command",
        )
    if fields.values.get("kind") is TaskKind.JOB and fields.values.get("restart") is RestartPolicy.ALWAYS:
        message = "a job that is always restarted never completes"
        problems.add(
            fields.node.key_mark("restart"), ProblemCode.CONTRADICTION, message, "write restart: on-failure"
        )
    _check_on_unhealthy(fields, problems)
    _check_self_fence(fields, problems)
    _check_foreground(fields, problems)
    _check_standby(fields, problems)


def _check_on_unhealthy(fields: Fields, problems: Problems) -> None:
    if "on_unhealthy" in fields and "alive" not in fields:
        message = "on_unhealthy without alive: nothing asks whether the task is alive"
        problems.add(
            fields.node.key_mark("on_unhealthy"),
            ProblemCode.CONTRADICTION,
            message,
            "add alive: {ros_node: /NAME}",
        )
    never = fields.values.get("restart") is RestartPolicy.NEVER
    if fields.values.get("on_unhealthy") is OnUnhealthy.RESTART and never:
        problems.add(
            fields.node.key_mark("on_unhealthy"),
            ProblemCode.CONTRADICTION,
            "on_unhealthy: restart and restart: never do not go together",
            "write on_unhealthy: report, or restart: on-failure",
        )


def _check_foreground(fields: Fields, problems: Problems) -> None:
    """A command that goes to the background has ended for its supervisor, which then ends what it left."""
    command = fields.values.get("command")
    if isinstance(command, str) and _TRAILING_AMPERSAND.search(command):
        problems.add(
            fields.at("command").mark,
            ProblemCode.BACKGROUND,
            "the command goes to the background, so the task ends at once",
            "drop the & at its end",
            warning=True,
        )


def _check_standby(fields: Fields, problems: Problems) -> None:
    """A copy waits on another host than the task, for a task that runs on."""
    if fields.values.get("standby") is None:
        return
    mark = fields.node.key_mark("standby")
    if fields.values.get("kind") is TaskKind.JOB:
        hint = "remove standby, or kind: job"
        problems.add(mark, ProblemCode.CONTRADICTION, "a job has no standby: it ends by itself", hint)
    if fields.values.get("onboard") is OnboardRule.ONLY:
        message = "standby and onboard: only do not go together: no other host may run the task"
        problems.add(mark, ProblemCode.CONTRADICTION, message, "remove standby, or onboard: only")
    handoff = fields.values.get("handoff")
    if handoff is not None and handoff.order is HandoffOrder.START_FIRST:
        message = "standby and order: start-first do not go together: two instances are never active at once"
        problems.add(mark, ProblemCode.CONTRADICTION, message, "remove standby, or order: start-first")


def _check_self_fence(fields: Fields, problems: Problems) -> None:
    """Nothing starts a task elsewhere while its old copy may still run."""
    fence = fields.values.get("self_fence")
    if fence is not None and fence < MIN_SELF_FENCE_S:
        message = (
            f"self_fence {format_duration(fence)} is too short: heartbeats are sent every quarter of it "
            f"({format_duration(fence / 4)}) and at most one a second, so it needs 4 x 1 s at least"
        )
        problems.add(
            fields.node.key_mark("self_fence"), ProblemCode.CONTRADICTION, message, "write self_fence: 5m"
        )
    policy, _ = fields.values.get("on_unreachable", (None, None))
    image = fields.values.get("image")
    if policy is UnreachablePolicy.REPLACE and image is not None and image.engine is ContainerEngine.SWARM:
        message = (
            "on_unreachable: replace and engine: swarm do not go together: a swarm may start a service after "
            "its host was given up"
        )
        hint = "write on_unreachable: hold, or engine: docker"
        mark = fields.node.key_mark("on_unreachable")
        problems.add(mark, ProblemCode.CONTRADICTION, message, hint)
    if policy is UnreachablePolicy.REPLACE and "self_fence" not in fields:
        message = (
            "on_unreachable: replace needs self_fence: a task on an unreachable host is replaced only "
            "if it stops itself there"
        )
        hint = (
            "add self_fence: 5m (several times the pause between two applies), "
            "or write hold and declare a host powered off by hand: edgectl fence HOST"
        )
        problems.add(fields.node.key_mark("on_unreachable"), ProblemCode.CONTRADICTION, message, hint)


def _check_unmanaged(template: TaskTemplate, problems: Problems) -> None:
    fields = template.fields
    for key in ("command", "image"):
        if key in fields:
            message = f"a task with managed: false is never started, so it has no {key}"
            mark = fields.node.key_mark(key)
            problems.add(mark, ProblemCode.CONTRADICTION, message, f"remove {key}, or remove managed: false")
    if "alive" in fields:
        problems.add(
            fields.node.key_mark("alive"),
            ProblemCode.CONTRADICTION,
            "alive is asked by the supervisor of a task, and a task with managed: false has none",
            "remove alive, or remove managed: false",
        )
    _check_unmanaged_latency(fields, problems)
    for key in ("standby", "state"):
        if key in fields:
            mark = fields.node.key_mark(key)
            message = f"{key} is for moves, and a task with managed: false is never moved"
            problems.add(mark, ProblemCode.CONTRADICTION, message, f"remove {key}, or remove managed: false")
    if "detect" not in fields:
        message = f"task {template.name} has managed: false, so it needs detect"
        problems.add(
            template.named_at,
            ProblemCode.MISSING,
            message,
            "add detect: {cmdline: 'a regular expression'} or {ros_node: /name}",
        )
    stated = fields.at("detect").value if "detect" in fields else None
    if isinstance(stated, dict) and ("cmdline" in stated) == ("ros_node" in stated):
        message = "detect needs one of cmdline and ros_node"
        problems.add(
            fields.at("detect").mark,
            ProblemCode.CONTRADICTION,
            message,
            "write {cmdline: 'a regular expression'} or {ros_node: /name}",
        )


def _check_unmanaged_latency(fields: Fields, problems: Problems) -> None:
    rule = fields.values.get("latency")
    if isinstance(rule, LatencyRule) and rule.metric:
        message = (
            "latency of a metric is what edgectl gives $EDGECTL_METRICS for, and managed: false has none"
        )
        mark = fields.node.key_mark("latency")
        problems.add(mark, ProblemCode.CONTRADICTION, message, "write topic: /NAME, or remove latency")
    if "heard" in fields:
        message = "heard is for moves, and a task with managed: false is never moved"
        mark = fields.node.key_mark("heard")
        problems.add(mark, ProblemCode.CONTRADICTION, message, "remove heard, or remove managed: false")


def check_draft(draft: TaskDraft, fleet: FleetIndex, problems: Problems) -> None:
    """What one expanded task asks of its robots."""
    _check_onboard(draft, fleet, problems)
    _check_robot_checks(draft, fleet, problems)
    _check_robot_ears(draft, fleet, problems)
    _check_placeholders(draft, problems)
    _check_demand(draft, problems)


def _check_onboard(draft: TaskDraft, fleet: FleetIndex, problems: Problems) -> None:
    fields = draft.template.fields
    if fields.values.get("onboard") is not OnboardRule.ONLY:
        return
    mark = fields.at("onboard").mark
    if len(draft.robots) != 1:
        message = f"onboard: only needs exactly one robot, and {draft.name} has {len(draft.robots) or 'none'}"
        problems.add(
            mark, ProblemCode.CONTRADICTION, message, "write for_each: robot, or robot: .., or onboard: allow"
        )
    elif not fleet.hosts[draft.robots[0]].onboard:
        message = f"onboard: only, but {draft.robots[0]} runs no tasks"
        problems.add(
            mark,
            ProblemCode.CONTRADICTION,
            message,
            f"write onboard: true at {draft.robots[0]} in the inventory, or onboard: allow here",
        )


def _check_robot_checks(draft: TaskDraft, fleet: FleetIndex, problems: Problems) -> None:
    for key, check, node in _list_checks(draft.template.fields):
        if check.on is not CheckLocation.ROBOT:
            continue
        if len(draft.robots) != 1:
            message = f"{key} runs on the robot, and {draft.name} has {len(draft.robots) or 'none'}"
            problems.add(
                node.mark,
                ProblemCode.CONTRADICTION,
                message,
                f"write {key}: {{on: host, command: ..}}, or give the task one robot",
            )
        elif not fleet.hosts[draft.robots[0]].probe:
            message = f"{key} runs on {draft.robots[0]}, which has probe: false: it will never be answered"
            problems.add(
                node.mark,
                ProblemCode.NEVER_ANSWERED,
                message,
                "write on: host, or remove probe: false",
                warning=True,
            )


def _check_robot_ears(draft: TaskDraft, fleet: FleetIndex, problems: Problems) -> None:
    """What the robot is to receive: the stamped messages of ``latency``, and what tells it of the task."""
    fields = draft.template.fields
    rule, heard = fields.values.get("latency"), fields.values.get("heard")
    asked = [("heard", "remove heard")] if isinstance(heard, HeardRule) else []
    if isinstance(rule, LatencyRule) and rule.topic and rule.on is CheckLocation.ROBOT:
        asked.append(("latency", "write on: host"))
    for key, hint in asked:
        silent = [name for name in draft.robots if not fleet.hosts[name].probe]
        if not draft.robots:
            message = f"{key} is read on the robot, and {draft.name} has none"
            mark = fields.at(key).mark
            problems.add(mark, ProblemCode.CONTRADICTION, message, f"{hint}, or give the task a robot")
        elif len(silent) == len(draft.robots):
            message = f"{key} is read on {silent[0]}, which has probe: false: it will never be known"
            mark, more = fields.at(key).mark, f"{hint}, or remove probe: false"
            problems.add(mark, ProblemCode.NEVER_ANSWERED, message, more, warning=True)


def _list_checks(fields: Fields) -> list[tuple[str, Check, Node]]:
    found: list[tuple[str, Check, Node]] = []
    found += [
        (key, fields.values[key], fields.at(key)) for key in ("ready", "done_when") if key in fields.values
    ]
    handoff = fields.values.get("handoff")
    inner = fields.at("handoff").value
    if handoff is not None and isinstance(inner, dict):
        hooks = ((key, getattr(handoff, key)) for key in ("safe_when", "hold", "release"))
        found += [(key, hook, inner[key]) for key, hook in hooks if hook is not None]
    return found


def _check_placeholders(draft: TaskDraft, problems: Problems) -> None:
    if len(draft.robots) == 1:
        return
    fields = draft.template.fields
    for key in PLACEHOLDER_KEYS:
        if has_placeholder(fields.values.get(key)):
            message = (
                "{robot} and {robot_host} need exactly one robot, "
                f"and {draft.name} has {len(draft.robots) or 'none'}"
            )
            problems.add(
                fields.at(key).mark,
                ProblemCode.PLACEHOLDER,
                message,
                "use $EDGECTL_ROBOTS, or give the task one robot: for_each: robot",
            )


def _check_demand(draft: TaskDraft, problems: Problems) -> None:
    fields = draft.template.fields
    if not fields.values.get("managed", True) or ("demand" in fields and "demand" not in fields.values):
        return
    written = fields.node.value if isinstance(fields.node.value, dict) else {}
    if "demand" not in written and suggest_name("demand", written.keys() - TASK_KEYS.keys()):
        return  # a slip of the finger, which is a problem of its own
    demand = fields.values.get("demand", Demand())
    stated = fields.at("demand").value if "demand" in fields else {}
    left_out = [
        resource.demand_key
        for resource in RESOURCES
        if demand[resource.name] is None
        and not resource.optional
        and (draft.robots or not resource.per_link)
        and not (isinstance(stated, dict) and resource.demand_key in stated)
    ]
    if left_out:
        mark = fields.at("demand").mark if "demand" in fields else draft.template.named_at
        message = (
            f"{draft.template.name} states no demand for {', '.join(left_out)}: "
            "counted as 0 until it is measured"
        )
        hint = (
            f"add demand: {{{', '.join(f'{key}: ..' for key in left_out)}}}; "
            "write 0 or measured if that is intended"
        )
        problems.add(mark, ProblemCode.NO_DEMAND, message, hint, warning=True)
