# SPDX-License-Identifier: Apache-2.0
"""Tree of what hangs on what: tasks below those that they need, with their hosts. Pure."""

from collections.abc import Iterator, Mapping, Sequence

from edgectl.model.task import Task
from edgectl.tui.rows import Frame
from edgectl.views.rows import list_task_runs
from edgectl.views.state import resolve_absent_task


def render_task_tree(frame: Frame, *, unicode: bool = True) -> str:
    """One line per task, below each task that it needs; what stands there already is not repeated."""
    tasks = frame.tasks.tasks
    below: dict[str, list[Task]] = {name: [] for name in tasks}
    roots = []
    for task in tasks.values():
        known = [need.task for need in task.needs if need.task in tasks]
        for need in known:
            below[need].append(task)
        if not known:
            roots.append(task)
    places = _list_places(frame)
    marks = ("├─ ", "└─ ", "│  ") if unicode else ("|- ", "`- ", "|  ")
    seen: set[str] = set()
    lines = [line for task in roots for line in _render_branch(task, below, places, marks, seen, "", "")]
    lines += [
        f"{task.name}  {places[task.name]} (circle)" for task in tasks.values() if task.name not in seen
    ]
    return "\n".join(lines) or "no task"


def _list_places(frame: Frame) -> Mapping[str, str]:
    """State and host of each task of the files."""
    found: dict[str, str] = {}
    for name, host, sample in list_task_runs(frame.snapshot):
        found.setdefault(name, f"{sample.state.value} on {host}")
    for name, task in frame.tasks.tasks.items():
        if name not in found:
            known = resolve_absent_task(task, frame.snapshot)
            found[name] = known.state + (f" on {known.host}" if known.host else "")
    return found


def _render_branch(
    task: Task,
    below: Mapping[str, Sequence[Task]],
    places: Mapping[str, str],
    marks: tuple[str, str, str],
    seen: set[str],
    first: str,
    rest: str,
) -> Iterator[str]:
    """The line of a task and those below; ``first`` and ``rest`` stand before its line and before theirs."""
    again = task.name in seen
    seen.add(task.name)
    inner = below[task.name]
    yield f"{first}{task.name}  {places[task.name]}" + (", see above" if again and inner else "")
    branch, last, line = marks
    for number, each in enumerate(() if again else inner):
        ends = number == len(inner) - 1
        yield from _render_branch(
            each,
            below,
            places,
            marks,
            seen,
            rest + (last if ends else branch),
            rest + ("   " if ends else line),
        )
