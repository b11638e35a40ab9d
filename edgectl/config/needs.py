# SPDX-License-Identifier: Apache-2.0
"""Resolution of ``needs`` between expanded tasks, and detection of cycles."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from graphlib import CycleError, TopologicalSorter

from edgectl.config.node import Node
from edgectl.config.problems import ProblemCode, Problems
from edgectl.config.task_file import TaskDraft, TaskTemplate
from edgectl.dataclass import dataclass
from edgectl.model.task import Need
from edgectl.names import natural_key

_MAX_CYCLES = 20


@dataclass(frozen=True, slots=True)
class TaskNames:
    """Names that a key may refer to: expanded tasks, templates, and the tasks of each template."""

    drafts: Mapping[str, TaskDraft]
    expansions: Mapping[str, list[str]]
    known: tuple[str, ...]


def index_task_names(drafts: Mapping[str, TaskDraft], templates: Mapping[str, TaskTemplate]) -> TaskNames:
    """The names of all tasks."""
    expansions: dict[str, list[str]] = {name: [] for name in templates}
    for name, draft in drafts.items():
        expansions[draft.template.name].append(name)
    return TaskNames(drafts, expansions, tuple(sorted({*templates, *drafts}, key=natural_key)))


def resolve_needs(
    drafts: Mapping[str, TaskDraft], names: TaskNames, problems: Problems
) -> dict[str, tuple[Need, ...]]:
    """The needs of every task; unknown names and cycles are collected as problems.

    Between two tasks made per robot, the same robot's task is needed; a task that is not made per robot needs
    all of them.
    """
    needs: dict[str, tuple[Need, ...]] = {}
    places: dict[tuple[str, str], Node] = {}
    for name, draft in drafts.items():
        found: dict[str, Need] = {}
        for need, node in draft.template.fields.values.get("needs", ()):
            for target in resolve_task_name(draft, need.task, node, names, problems):
                if need.restart is not None and not drafts[target].template.fields.values.get(
                    "managed", True
                ):
                    message = f"edgectl does not start {target}, so it cannot tell its restarts"
                    problems.add(node.mark, ProblemCode.CONTRADICTION, message, "remove restart: with")
                if target in found:
                    problems.add(node.mark, ProblemCode.TAKEN, f"{target} is needed twice", "name it once")
                found[target] = replace(need, task=target)
                places[name, target] = node
        needs[name] = tuple(found[target] for target in sorted(found, key=natural_key))
    _report_cycles({name: [need.task for need in found] for name, found in needs.items()}, places, problems)
    return needs


def resolve_task_name(
    draft: TaskDraft, wanted: str, node: Node, names: TaskNames, problems: Problems
) -> Sequence[str]:
    """The tasks that ``draft`` means by ``wanted``: that one, that of the same robot, or all of an entry."""
    if wanted in names.drafts:
        return (wanted,)
    if wanted not in names.expansions:
        # As in a command, where a placeholder stands for the robot; here its task is meant anyway.
        entry = wanted.partition("{")[0].rstrip("-_")
        hint = (
            f"write {entry}, which means that of the same robot"
            if entry != wanted and entry in names.expansions
            else problems.did_you_mean(wanted, names.known, "the tasks are")
        )
        problems.add(node.mark, ProblemCode.UNKNOWN_NAME, f"unknown task {wanted}", hint)
        return ()
    expanded = names.expansions[wanted]
    if draft.each is None:
        return expanded
    same = f"{wanted}-{draft.each}"
    if same not in names.drafts and expanded:
        message = f"{wanted} has no task for {draft.each}, which {draft.template.name} is made for"
        problems.add(
            node.mark,
            ProblemCode.UNKNOWN_NAME,
            message,
            f"add {draft.each} to the for_each of {wanted}, or write {expanded[0]}",
        )
    return (same,) if same in names.drafts else ()


def _report_cycles(
    graph: dict[str, list[str]], places: Mapping[tuple[str, str], Node], problems: Problems
) -> None:
    for _ in range(_MAX_CYCLES):
        cycle = _find_cycle(graph)
        if not cycle:
            return
        first, second = cycle[0], cycle[1]
        graph[first].remove(second)
        message = f"{first} needs itself: {' -> '.join(cycle)}"
        problems.add(
            places[first, second].mark,
            ProblemCode.CYCLE,
            message,
            f"remove one of these needs, such as {second} from {first}",
        )


def _find_cycle(graph: Mapping[str, list[str]]) -> list[str]:
    """One cycle, each needing the next, with its first name at both ends; empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        path: list[str] = error.args[1][:0:-1]
        start = path.index(min(path, key=natural_key))
        return [*path[start:], *path[:start], path[start]]
    return []
