# SPDX-License-Identifier: Apache-2.0
"""Expansion of templates into tasks: one per robot with ``for_each``, placeholders filled in and needs
resolved.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from edgectl.config.host_rules import FleetIndex, index_fleet, resolve_host_rules
from edgectl.config.needs import index_task_names, resolve_needs
from edgectl.config.node import Node
from edgectl.config.placeholders import fill_placeholders
from edgectl.config.placement_rules import COMPANION_KEYS, check_placement_rules, resolve_companions
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.ros_rules import check_ros
from edgectl.config.scalars import MAX_NAME_LENGTH
from edgectl.config.task_file import MAX_TASKS, TaskDraft, TaskTemplate
from edgectl.config.task_rules import check_draft, check_template
from edgectl.formats.digest import hash_spec, hash_spec_fields
from edgectl.model.inventory import Inventory
from edgectl.model.task import HostRules, Need, Task
from edgectl.names import natural_key

_KEYS_READ_ELSEWHERE = (
    "for_each",
    "robot",
    "robots",
    "needs",
    "hosts",
    "on_unreachable",
    "on_unhealthy",
    "deadline",
    *COMPANION_KEYS,
)


def expand_templates(
    templates: Mapping[str, TaskTemplate], inventory: Inventory, problems: Problems
) -> dict[str, Task]:
    """All tasks in natural order of their names; problems are collected."""
    fleet = index_fleet(inventory)
    drafts: dict[str, TaskDraft] = {}
    for template in templates.values():
        check_template(template, problems)
        for draft in _expand_template(template, fleet.robots, problems):
            if len(drafts) >= MAX_TASKS:
                problems.add(
                    template.named_at,
                    ProblemCode.TOO_MANY,
                    f"more than {MAX_TASKS:,} tasks after for_each",
                    "split them over several fleets",
                )
                return {}
            _add_draft(draft, drafts, problems)
    names = index_task_names(drafts, templates)
    needs = resolve_needs(drafts, names, problems)
    companions = resolve_companions(drafts, names, problems)
    tasks = {}
    for name in sorted(drafts, key=natural_key):
        check_draft(drafts[name], fleet, problems)
        hosts = resolve_host_rules(drafts[name], fleet, problems)
        tasks[name] = _build_task(drafts[name], needs[name], hosts, companions.get(name, {}), fleet)
    check_placement_rules(tasks, drafts, fleet, problems)
    check_ros(tasks, drafts, inventory, problems)
    return tasks


def _add_draft(draft: TaskDraft, drafts: dict[str, TaskDraft], problems: Problems) -> None:
    mark = draft.template.named_at
    if draft.name in drafts:
        message = (
            f"{draft.template.name} makes a task {draft.name}, and {drafts[draft.name].template.name} does "
            "too"
        )
        problems.add(mark, ProblemCode.TAKEN, message, "rename one of the two")
    elif len(draft.name) > MAX_NAME_LENGTH:
        problems.add(
            mark,
            ProblemCode.NAME,
            f"the task name {draft.name} is longer than {MAX_NAME_LENGTH} characters",
            "shorten the name of the task or of the robot",
        )
    else:
        drafts[draft.name] = draft


def _expand_template(
    template: TaskTemplate, every: tuple[str, ...], problems: Problems
) -> Iterator[TaskDraft]:
    fields = template.fields
    if "for_each" in fields:
        node = fields.at("for_each")
        if not every:
            problems.add(
                node.mark,
                ProblemCode.UNKNOWN_NAME,
                "for_each: robot, but the inventory has no robots",
                "add robots: to the inventory",
            )
        for robot in _resolve_robots(fields.values.get("for_each", ()), every, problems):
            yield TaskDraft(template, f"{template.name}-{robot}", (robot,), each=robot)
    elif "robot" in fields:
        entries = ((fields.values["robot"], fields.at("robot")),) if "robot" in fields.values else ()
        yield TaskDraft(template, template.name, _resolve_robots(entries, every, problems))
    else:
        yield TaskDraft(
            template, template.name, _resolve_robots(fields.values.get("robots", ()), every, problems)
        )


def _resolve_robots(
    wanted: str | tuple[tuple[str, Node], ...], every: tuple[str, ...], problems: Problems
) -> tuple[str, ...]:
    """The selected robots in the order written, limited to those of the inventory."""
    if isinstance(wanted, str):
        return every
    for name, node in wanted:
        if name not in every:
            problems.add(
                node.mark,
                ProblemCode.UNKNOWN_NAME,
                f"unknown robot {name}",
                problems.did_you_mean(name, every, "the robots are"),
            )
    return tuple(dict.fromkeys(name for name, _ in wanted if name in every))


def _build_task(
    draft: TaskDraft,
    needs: tuple[Need, ...],
    hosts: HostRules,
    companions: Mapping[str, tuple[str, ...]],
    fleet: FleetIndex,
) -> Task:
    values: dict[str, Any] = {
        key: value for key, value in draft.template.fields.values.items() if key not in _KEYS_READ_ELSEWHERE
    }
    if len(draft.robots) == 1:
        values = fill_placeholders(values, fleet.hosts[draft.robots[0]])
    unreachable, after = draft.template.fields.values.get("on_unreachable", (None, None))
    values |= {"on_unreachable": unreachable} if unreachable is not None else {}
    values |= {"replace_after": after} if after is not None else {}
    if "deadline" in draft.template.fields.values:
        values["deadline"], values["hard_deadline"] = draft.template.fields.values["deadline"]
    values |= companions
    values.setdefault("command", "")
    if "alive" in values:
        # Otherwise a restart that did not help would count as a success, and be repeated for ever.
        values.setdefault("ready", values["alive"].check)
        policy = draft.template.fields.values.get("on_unhealthy")
        values["alive"] = replace(values["alive"], **({"on_unhealthy": policy} if policy else {}))
    task = Task(
        name=draft.name,
        template=draft.template.name,
        spec_hash="",
        robots=draft.robots,
        needs=needs,
        hosts=hosts,
        file=draft.template.file,
        **values,
    )
    return replace(task, spec_hash=hash_spec(task), spec_fields=hash_spec_fields(task))
