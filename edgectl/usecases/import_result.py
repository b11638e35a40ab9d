"""Result of an import: the texts of the new files, and what is not in them."""

import secrets
from collections.abc import Sequence
from dataclasses import replace

from edgectl.config.expansion import expand_templates
from edgectl.config.inventory_merge import read_inventories
from edgectl.config.problems import Problems
from edgectl.config.source import decode_source
from edgectl.config.task_file import TaskTemplate, merge_policy, read_templates
from edgectl.config.yaml_parser import parse_yaml
from edgectl.dataclass import dataclass
from edgectl.errors import Problem


@dataclass(frozen=True, slots=True, kw_only=True)
class Imported:
    """Texts of the new files, empty where there is none; ``name`` of both, and what is not in them."""

    name: str
    inventory: str
    tasks: str
    notes: tuple[Problem, ...]


def name_fleet(name: str) -> str:
    """A fleet name that nobody else has on the same hosts."""
    return f"{name}-{secrets.token_hex(3)}"


def finish_import(name: str, inventory: str, tasks: str, notes: Sequence[Problem]) -> Imported:
    """The result with the notes of ``edgectl validate``."""
    return Imported(
        name=name, inventory=inventory, tasks=tasks, notes=(*notes, *_check_result(name, inventory, tasks))
    )


def _check_result(name: str, inventory: str, tasks: str) -> list[Problem]:
    """What ``edgectl validate`` will refuse: only the user can say what is meant there."""
    problems = Problems()
    templates: dict[str, TaskTemplate] = {}
    source = decode_source(f"inventories/{name}.yaml", inventory.encode(), problems)
    node = parse_yaml(source, problems) if source is not None else None
    fleet = read_inventories([node], problems) if node is not None else None
    source = decode_source(f"tasks/{name}.yaml", tasks.encode(), problems) if tasks else None
    node = parse_yaml(source, problems) if source is not None else None
    if node is not None and fleet is not None:
        merge_policy([read_templates(node, problems, templates, name)], problems)
        expand_templates(templates, fleet, problems)
    return [replace(problem, warning=True) for problem in problems.errors]
