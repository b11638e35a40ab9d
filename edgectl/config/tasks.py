"""The task files: templates, one per entry as written, and the policy that the files state."""

from dataclasses import dataclass
from typing import Any

from edgectl.config.fields import Fields, read_fields
from edgectl.config.node import Node
from edgectl.config.problems import Code, Mark, Problems
from edgectl.config.scalars import check_name, wrong_type
from edgectl.config.taskfields import POLICY, TASK, TASKS
from edgectl.model.policy import Policy

MAX_TASKS = 10_000


@dataclass(frozen=True, slots=True)
class Template:
    """One entry of ``tasks:`` as written, before ``for_each`` is expanded."""

    name: str
    fields: Fields
    named_at: Mark


@dataclass(frozen=True, slots=True)
class Draft:
    """One task to be: its template, its own name and its robots. ``each`` is the robot that ``for_each`` made it for."""

    template: Template
    name: str
    robots: tuple[str, ...]
    each: str | None = None


def read_templates(node: Node, problems: Problems, templates: dict[str, Template]) -> Fields:
    """Add one file's templates to ``templates``, with everything wrong noted; gives the file's other keys."""
    top = read_fields(node, problems, TASKS, required=("version", "tasks"), what="a task file")
    entries = top.at("tasks")
    if "tasks" in top and not isinstance(entries.value, dict):
        wrong_type(entries, problems, "tasks must be a mapping of names", "write a name, a colon and the task's keys below it")
    for key, inner in entries.value.items() if "tasks" in top and isinstance(entries.value, dict) else ():
        check_name(key, entries, problems, "a task")
        if key in templates:
            first = templates[key].named_at
            message = f"a task {key} stands in {first.source.file} already, on line {first.line}"
            problems.add(entries.key_mark(key), Code.TAKEN, message, "rename or remove one of the two")
            continue
        fields = read_fields(inner, problems, TASK, what=f"task {key}")
        templates[key] = Template(key, fields, entries.key_mark(key))
    return top


def merge_policy(files: list[Fields], problems: Problems) -> Policy:
    """The policy that the files state together; stating a key twice differently is a mistake."""
    stated: dict[str, Any] = {}
    for fields in files:
        for key in POLICY:
            if key not in fields.values:
                continue
            if key in stated and stated[key] != fields.values[key]:
                problems.add(
                    fields.node.key_mark(key), Code.TAKEN, f"{key} is stated differently in another file", f"keep {key} in one file"
                )
            stated[key] = fields.values[key]
    return Policy(**({"name": stated.pop("policy")} if "policy" in stated else {}), **stated)
