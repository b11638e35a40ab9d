# SPDX-License-Identifier: Apache-2.0
"""Rules between tasks: ``apart``, ``together``, ``spread`` and ``group``, resolved and checked."""

from collections.abc import Mapping

from edgectl.config.host_rules import FleetIndex
from edgectl.config.needs import TaskNames, resolve_task_name
from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.task_file import TaskDraft
from edgectl.model.inventory import Host, Role
from edgectl.model.task import OnboardRule, Task, join_units
from edgectl.names import natural_key

COMPANION_KEYS = ("apart", "together")
# Value of ``spread`` that is no label.
EVERY_HOST = "host"


def resolve_companions(
    drafts: Mapping[str, TaskDraft], names: TaskNames, problems: Problems
) -> dict[str, dict[str, tuple[str, ...]]]:
    """``apart`` and ``together`` with expanded names, by task that states any; unknown names are problems.

    Names are resolved as those of ``needs``. An entry that names itself means its other tasks.
    """
    found: dict[str, dict[str, tuple[str, ...]]] = {}
    for name, draft in drafts.items():
        stated = {
            key: _resolve_names(draft, key, names, problems)
            for key in COMPANION_KEYS
            if key in draft.template.fields.values
        }
        if stated:
            found[name] = stated
    return found


def _resolve_names(draft: TaskDraft, key: str, names: TaskNames, problems: Problems) -> tuple[str, ...]:
    targets: dict[str, None] = {}
    for wanted, node in draft.template.fields.values[key]:
        own = wanted == draft.template.name
        found = names.expansions[wanted] if own else resolve_task_name(draft, wanted, node, names, problems)
        others = [name for name in found if name != draft.name]
        if draft.name in found and not others:
            problems.add(
                node.mark,
                ProblemCode.CONTRADICTION,
                f"{draft.name} names itself in {key}",
                f"name other tasks, or remove {wanted}",
            )
        targets |= dict.fromkeys(others)
    return tuple(sorted(targets, key=natural_key))


def check_placement_rules(
    tasks: Mapping[str, Task], drafts: Mapping[str, TaskDraft], fleet: FleetIndex, problems: Problems
) -> None:
    """Rules that contradict each other, and rules that mean nothing."""
    units = join_units(tasks)
    _check_groups(tasks, drafts, problems)
    for name, task in tasks.items():
        for other in task.apart:
            _check_apart(task, tasks[other], units, drafts[name], fleet, problems)
        if task.together:
            _check_together(units[name], tasks, drafts[name], fleet, problems)
        if task.spread is not None:
            _check_spread(task, tasks, units, drafts[name], fleet, problems)
        if task.standby is not None:
            _check_standby(task, units.get(name, ()), drafts[name], fleet, problems)


def _check_apart(
    task: Task,
    other: Task,
    units: Mapping[str, tuple[str, ...]],
    draft: TaskDraft,
    fleet: FleetIndex,
    problems: Problems,
) -> None:
    node = _find_entry(draft, "apart", other)
    if other.name in units.get(task.name, ()):
        problems.add(
            node.mark,
            ProblemCode.CONTRADICTION,
            f"{task.name} is apart from {other.name} and together with it",
            f"remove {node.text} from apart, or the together that joins them",
        )
        return
    allowed = _list_allowed_hosts(task, fleet)
    if len(allowed) == 1 and allowed == _list_allowed_hosts(other, fleet):
        problems.add(
            node.mark,
            ProblemCode.CONTRADICTION,
            f"{task.name} is apart from {other.name}, and both may run on {next(iter(allowed))} alone",
            f"remove {node.text} from apart, or let one of them run elsewhere",
        )


def _check_together(
    unit: tuple[str, ...],
    tasks: Mapping[str, Task],
    draft: TaskDraft,
    fleet: FleetIndex,
    problems: Problems,
) -> None:
    """Some host may run all of ``unit``, as far as the files say."""
    common = set(fleet.hosts).intersection(*(_list_allowed_hosts(tasks[name], fleet) for name in unit))
    if common:
        return
    pinned = {name: pin for name in unit if (pin := tasks[name].hosts.pin) is not None}
    if len(set(pinned.values())) > 1:
        where = " and ".join(f"{name} to {pin}" for name, pin in pinned.items())
        message, hint = f"tasks that go together are pinned apart: {where}", "pin them to one host"
    else:
        message = f"no host may run {' and '.join(unit)} together"
        hint = "allow one host in the hosts and onboard of all of them"
    problems.add(
        draft.template.fields.at("together").mark,
        ProblemCode.CONTRADICTION,
        message,
        f"{hint}, or remove together",
    )


def _check_spread(
    task: Task,
    tasks: Mapping[str, Task],
    units: Mapping[str, tuple[str, ...]],
    draft: TaskDraft,
    fleet: FleetIndex,
    problems: Problems,
) -> None:
    node = draft.template.fields.at("spread")
    label = task.spread or EVERY_HOST
    if label != EVERY_HOST and label not in fleet.labels:
        hint = problems.did_you_mean(label, [EVERY_HOST, *fleet.labels], "write host, or a label:")
        problems.add(node.mark, ProblemCode.UNKNOWN_NAME, f"no host has a label {label}", hint)
    siblings = [name for name, other in tasks.items() if other.template == task.template]
    if len(siblings) == 1:
        problems.add(
            node.mark,
            ProblemCode.CONTRADICTION,
            f"{task.name} is one task, which cannot be spread",
            "add for_each, or remove spread",
        )
    together = [name for name in units.get(task.name, ()) if name != task.name and name in siblings]
    if together:
        problems.add(
            node.mark,
            ProblemCode.CONTRADICTION,
            f"{task.name} and {together[0]} are spread and together",
            "remove spread, or the together that joins them",
        )


def _check_standby(
    task: Task, unit: tuple[str, ...], draft: TaskDraft, fleet: FleetIndex, problems: Problems
) -> None:
    """Another host may run the task, and it alone."""
    mark = draft.template.fields.node.key_mark("standby")
    mates = [name for name in unit if name != task.name]
    if mates:
        message = f"standby of {task.name}, which is together with {mates[0]}: its copy would be without it"
        hint = "remove standby, or the together that joins them"
        problems.add(mark, ProblemCode.CONTRADICTION, message, hint)
        return
    allowed = sorted(_list_allowed_hosts(task, fleet), key=natural_key)
    if len(allowed) == 1 and task.onboard is not OnboardRule.ONLY:
        message = f"standby of {task.name} needs a second host, and only {allowed[0]} may run it"
        hint = "allow another host in its hosts, or remove standby"
        problems.add(mark, ProblemCode.CONTRADICTION, message, hint)


def _check_groups(tasks: Mapping[str, Task], drafts: Mapping[str, TaskDraft], problems: Problems) -> None:
    members: dict[str, list[str]] = {}
    for name, task in tasks.items():
        if task.group is not None:
            members.setdefault(task.group, []).append(name)
    for group, names in members.items():
        if len(names) > 1:
            continue
        others = [other for other in members if other != group]
        node = drafts[names[0]].template.fields.at("group")
        hint = problems.did_you_mean(group, others, "give other tasks this group, or one of")
        problems.add(
            node.mark,
            ProblemCode.CONTRADICTION,
            f"{names[0]} is the only task of the group {group}",
            hint or "give other tasks this group, or remove it",
        )


def _find_entry(draft: TaskDraft, key: str, other: Task) -> Node:
    """The entry of a list that means ``other``."""
    entries: tuple[tuple[str, Node], ...] = draft.template.fields.values[key]
    return next(node for name, node in entries if name in (other.name, other.template))


def _list_allowed_hosts(task: Task, fleet: FleetIndex) -> set[str]:
    return {name for name, host in fleet.hosts.items() if _is_allowed(task, host)}


def _is_allowed(task: Task, host: Host) -> bool:
    """Whether the files let ``task`` run on ``host``."""
    rules = task.hosts
    if host.role is Role.ROBOT:
        if task.onboard is OnboardRule.NEVER or not host.onboard or task.robots != (host.name,):
            return False
    elif task.onboard is OnboardRule.ONLY:
        return False
    return (
        rules.pin in (None, host.name)
        and (not rules.only or host.name in rules.only)
        and host.name not in rules.never
        and all(host.labels.get(key) == value for key, value in rules.labels.items())
    )
