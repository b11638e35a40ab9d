"""Templates to tasks: one per robot where ``for_each`` says so, with placeholders filled in and needs resolved."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from edgectl.config.needs import resolve_needs
from edgectl.config.node import Node
from edgectl.config.placeholders import filled
from edgectl.config.problems import Code, Problems
from edgectl.config.rules import Fleet, check_draft, check_template, fleet_of, host_rules
from edgectl.config.scalars import NAME_LENGTH
from edgectl.config.tasks import MAX_TASKS, Draft, Template
from edgectl.formats.digest import spec_fields, spec_hash
from edgectl.model.inventory import Inventory
from edgectl.model.order import natural_key
from edgectl.model.task import HostRules, Need, Task

_READ_ELSEWHERE = ("for_each", "robot", "robots", "needs", "hosts", "on_unreachable")


def expand(templates: Mapping[str, Template], inventory: Inventory, problems: Problems) -> dict[str, Task]:
    """All tasks in natural order of their names, with everything wrong noted."""
    fleet = fleet_of(inventory)
    drafts: dict[str, Draft] = {}
    for template in templates.values():
        check_template(template, problems)
        for draft in _drafts(template, fleet.robots, problems):
            if len(drafts) >= MAX_TASKS:
                problems.add(
                    template.named_at, Code.TOO_MANY, f"more than {MAX_TASKS:,} tasks after for_each", "split them over several fleets"
                )
                return {}
            _add(draft, drafts, problems)
    needs = resolve_needs(drafts, templates, problems)
    tasks = {}
    for name in sorted(drafts, key=natural_key):
        check_draft(drafts[name], fleet, problems)
        tasks[name] = _task(drafts[name], needs[name], host_rules(drafts[name], fleet, problems), fleet)
    return tasks


def _add(draft: Draft, drafts: dict[str, Draft], problems: Problems) -> None:
    mark = draft.template.named_at
    if draft.name in drafts:
        message = f"{draft.template.name} makes a task {draft.name}, and {drafts[draft.name].template.name} does too"
        problems.add(mark, Code.TAKEN, message, "rename one of the two")
    elif len(draft.name) > NAME_LENGTH:
        problems.add(
            mark,
            Code.NAME,
            f"the task's name {draft.name} is longer than {NAME_LENGTH} characters",
            "shorten the task's or the robot's name",
        )
    else:
        drafts[draft.name] = draft


def _drafts(template: Template, every: tuple[str, ...], problems: Problems) -> Iterator[Draft]:
    fields = template.fields
    if "for_each" in fields:
        node = fields.at("for_each")
        if not every:
            problems.add(node.mark, Code.UNKNOWN_NAME, "for_each: robot, and the inventory has no robots", "add robots: to the inventory")
        for robot in _robots(fields.values.get("for_each", ()), every, problems):
            yield Draft(template, f"{template.name}-{robot}", (robot,), each=robot)
    elif "robot" in fields:
        entries = ((fields.values["robot"], fields.at("robot")),) if "robot" in fields.values else ()
        yield Draft(template, template.name, _robots(entries, every, problems))
    else:
        yield Draft(template, template.name, _robots(fields.values.get("robots", ()), every, problems))


def _robots(wanted: str | tuple[tuple[str, Node], ...], every: tuple[str, ...], problems: Problems) -> tuple[str, ...]:
    """The robots that are meant, in the order written, those of the inventory only."""
    if isinstance(wanted, str):
        return every
    for name, node in wanted:
        if name not in every:
            problems.add(node.mark, Code.UNKNOWN_NAME, f"unknown robot {name}", problems.did_you_mean(name, every, "the robots are"))
    return tuple(dict.fromkeys(name for name, _ in wanted if name in every))


def _task(draft: Draft, needs: tuple[Need, ...], hosts: HostRules, fleet: Fleet) -> Task:
    values: dict[str, Any] = {key: value for key, value in draft.template.fields.values.items() if key not in _READ_ELSEWHERE}
    if len(draft.robots) == 1:
        values = filled(values, fleet.hosts[draft.robots[0]])
    policy, after = draft.template.fields.values.get("on_unreachable", (None, None))
    values |= {"on_unreachable": policy} if policy is not None else {}
    values |= {"replace_after": after} if after is not None else {}
    values.setdefault("command", "")
    task = Task(name=draft.name, template=draft.template.name, spec_hash="", robots=draft.robots, needs=needs, hosts=hosts, **values)
    return replace(task, spec_hash=spec_hash(task), spec_fields=spec_fields(task))
