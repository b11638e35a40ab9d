# SPDX-License-Identifier: Apache-2.0
"""Measured usage of a task, and writing it into the task file as its demand."""

import difflib
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from edgectl.config.load import load_tasks
from edgectl.config.problems import Problems, Source
from edgectl.config.source import read_source
from edgectl.config.task_file_edit import edit_demand
from edgectl.dataclass import dataclass
from edgectl.errors import EdgectlError, FileError
from edgectl.model.demand import Demand, Quantity
from edgectl.model.profile import ClassProfile
from edgectl.model.resource import RESOURCES, TASK_RESOURCES, Resource
from edgectl.model.task import Task, Tasks
from edgectl.rules.measured_demand import MIN_SAMPLES, MIN_SPAN_S
from edgectl.units import format_duration
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.measured_demand import load_class_profiles


@dataclass(frozen=True, slots=True, kw_only=True)
class DemandEdit:
    """An edited task file. ``tasks``: all tasks of the edited entry; ``before`` and ``after``: its text."""

    file: Path
    entry: str
    tasks: tuple[str, ...]
    before: str
    after: str

    def diff(self) -> str:
        """The changed lines without context; a line that may contain a secret is masked."""
        old, new = self.before.splitlines(), self.after.splitlines()
        head, body = (
            [f"--- {self.file}\n", f"+++ {self.file}\n"],
            list(difflib.unified_diff(old, new, n=0, lineterm=""))[2:],
        )
        return "".join([*head, *(line[0] + _hide_secret_line(line[1:]) + "\n" for line in body)])


def _hide_secret_line(line: str) -> str:
    """The line, masked if it may contain a secret."""
    return Source(file="", text=line, lines=(line,)).line(1) or "(not shown)"


def get_tasks_by_name(tasks: Tasks, name: str) -> list[Task]:
    """The task of this name, or all tasks of the entry of this name.

    Raises:
        KeyError: there is neither.
    """
    if name in tasks.tasks:
        return [tasks.tasks[name]]
    found = [task for task in tasks.tasks.values() if task.template == name]
    if not found:
        raise KeyError(name)
    return found


def build_demand_edit(fleet: Fleet, files: Sequence[Path], task: Task) -> DemandEdit:
    """The file with p95 as the demand of the entry of ``task``: the maximum over its tasks and classes of
    hosts.

    Raises:
        EdgectlError: there are too few samples.
        InputError: the entry cannot be edited safely.
        FileError: the edited file would have another meaning, or is gone.
    """
    group = [each for each in fleet.tasks.tasks.values() if each.template == task.template]
    amounts = _format_p95_amounts(task.template, load_class_profiles(fleet, group))
    for file in files:
        problems = Problems()
        source = read_source(file, problems)
        problems.check()
        after = edit_demand(source, task.template, amounts) if source is not None else None
        if source is not None and after is not None:
            _check_meaning(fleet, files, file, after, _build_expected_demands(group, amounts))
            return DemandEdit(
                file=file,
                entry=task.template,
                tasks=tuple(each.name for each in group),
                before=source.text,
                after=after,
            )
    raise FileError(f"{task.template} is no longer in any of the task files", hint="run the command again")


def _format_p95_amounts(entry: str, found: Iterable[ClassProfile]) -> dict[str, str]:
    """The demands as written in the file, by resource; no throughput where no traffic was measured."""
    known = list(found)
    trusted = [each for each in known if each.enough]
    if not trusted:
        most = max(known, key=lambda each: each.profile.samples, default=None)
        so_far = (
            f"{most.profile.samples} samples over {format_duration(most.profile.span_s)}"
            if most
            else "no sample"
        )
        hint = (
            f"{MIN_SAMPLES} samples over {format_duration(MIN_SPAN_S)} are needed; let it run while edgectl "
            "probes or watches"
        )
        raise EdgectlError(f"{entry} has {so_far}: too few to write a demand", hint=hint)
    return {
        resource.demand_key: resource.unit.format_for_file(max(values))
        for resource in TASK_RESOURCES
        if (values := _list_p95(trusted, resource))
    }


def _list_p95(trusted: Iterable[ClassProfile], resource: Resource) -> list[float]:
    """The figures of each class of hosts; of a link only those that saw traffic."""
    found = [(each.task, each.profile.used[resource.name]) for each in trusted]
    if not resource.per_link:
        return [spread.p95 for _, spread in found]
    return [spread.p95 for task, spread in found if task.robots and spread.most > 0]


def _build_expected_demands(group: Sequence[Task], amounts: dict[str, str]) -> dict[str, Demand]:
    """The demands that the edited file must give: what follows history still does, everything else is
    unchanged.
    """
    return {
        task.name: Demand(
            {
                **task.demand,
                **{
                    resource.name: _parse_amount(
                        task.demand[resource.name], resource, amounts[resource.demand_key]
                    )
                    for resource in RESOURCES
                    if resource.demand_key in amounts
                },
            }
        )
        for task in group
    }


def _parse_amount(old: Quantity | None, resource: Resource, amount: str) -> Quantity:
    return Quantity(value=resource.unit.parse(amount), measured=old is not None and old.measured)


def _check_meaning(
    fleet: Fleet, files: Sequence[Path], file: Path, after: str, meant: dict[str, Demand]
) -> None:
    """Read all files with the edited one among them: only the demands may differ."""
    wanted = {
        name: replace(task, demand=meant.get(name, task.demand), file="")
        for name, task in fleet.tasks.tasks.items()
    }
    with tempfile.TemporaryDirectory(prefix="edgectl-") as directory:
        edited = Path(directory) / file.name
        edited.write_text(after, encoding="utf-8", newline="")
        found = load_tasks([edited if each == file else each for each in files], fleet.inventory)
    read = {name: replace(task, file="") for name, task in found.tasks.items()}
    if read != wanted or found.policy != fleet.tasks.policy:
        raise FileError(
            f"{file} changed meanwhile, or would have another meaning",
            hint="run the command again; if it happens again, edit the demand by hand",
        )
