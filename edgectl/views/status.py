# SPDX-License-Identifier: Apache-2.0
"""The status of every task: host, state, age, usage against demand, and remarks on what needs attention."""

from collections.abc import Iterable, Iterator, Sequence

from edgectl.formats.document import Document
from edgectl.model.assignment import Shortage
from edgectl.model.inventory import Inventory
from edgectl.model.resource import RESOURCES
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState
from edgectl.model.task import Task, Tasks, list_node_names
from edgectl.rules.cut_off import list_cut_off_tasks
from edgectl.rules.lost_places import describe_lost_place
from edgectl.rules.overuse import find_overuses
from edgectl.units import format_duration
from edgectl.views.glossary import head
from edgectl.views.latency import RIGHT_COLUMNS, list_latency_notes, render_latency_rows
from edgectl.views.notes import (
    list_doubled_notes,
    list_lost_task_notes,
    list_snapshot_notes,
    list_unreachable_notes,
)
from edgectl.views.other_tasks import list_foreign_notes
from edgectl.views.output import ListView
from edgectl.views.output_format import FLEET_FORMATS
from edgectl.views.plan_sections import (
    list_operator_mark_notes,
)
from edgectl.views.rows import (
    compute_task_age,
    encode_absent_row,
    encode_run_row,
    find_task_demand,
    list_task_runs,
)
from edgectl.views.standbys import (
    describe_standby_fault,
    encode_standby_row,
    list_standby_faults,
    list_standby_runs,
    render_standby_state,
)
from edgectl.views.state import (
    TASK_STATE_STYLES,
    describe_attention,
    find_failed_tasks,
    format_silence,
    format_task_state,
    is_restarting,
    list_failed_needs,
    list_restarting_tasks,
    list_task_remarks,
    list_unhealthy_tasks,
    resolve_absent_task,
)
from edgectl.views.text import (
    PLAIN,
    Cell,
    RenderOptions,
    Row,
    escape_unprintable,
    is_within_width,
    render_columns,
    render_header,
    style_text,
    wrap_text,
)
from edgectl.views.usage import Amounts, format_or_dash

_USAGE_COLUMNS = [
    f"{resource.name}.{amount}_{resource.unit.name}"
    for resource in RESOURCES
    for amount in ("used", "demand")
]
_HEAD = head("task", "host", "state", "age_s", *_USAGE_COLUMNS)
_FIRST_USAGE = 4


class StatusView(ListView):
    """One row per task and host that reports it, and one per task of the files that no host reports."""

    kind = "task-status"
    formats = FLEET_FORMATS

    def __init__(
        self, snapshot: Snapshot, inventory: Inventory, tasks: Tasks, shortages: Sequence[Shortage] = ()
    ) -> None:
        self._snapshot, self._inventory, self._tasks = snapshot, inventory, tasks
        self._shortages = shortages
        self._failed = find_failed_tasks(tasks, snapshot)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """First what is wrong now; usage beside demand, or below on a narrow terminal; on a very narrow one
        only the resources for which there is room.
        """
        rows = self._list_rows()
        if len(rows) == 1:
            return ""
        if is_within_width(_with_short_states(rows), look):
            return self._render(rows, look, right=set(range(3, len(_HEAD))))
        stacked = _drop_usage_columns(list(_stack_demand_rows(rows)), look)
        return self._render(stacked, look, right=set(range(3, _FIRST_USAGE + len(RESOURCES))))

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The same with the ROS nodes of each task, as far as they are known."""
        rows = self._list_named_rows()
        if not rows:
            return ""
        wider: list[Row] = [(*_HEAD, *head("node_names"))]
        wider += [(*row, ", ".join(self._list_nodes(name)) or "-") for name, row in rows]
        return self._render(wider, look, right=set(range(3, len(_HEAD))))

    def _list_rows(self) -> list[Row]:
        """The heading, then the rows."""
        return [_HEAD, *(row for _, row in self._list_named_rows())]

    def _list_named_rows(self) -> list[tuple[str, Row]]:
        """Each row with the name of its task: what runs, then what does not, each with its copies below."""
        copies: dict[str, list[Row]] = {}
        for run in list_standby_runs(self._snapshot):
            copies.setdefault(run[0], []).append(self._render_standby_row(run))
        rows = [(run[0], self._render_run_row(run)) for run in list_task_runs(self._snapshot)]
        rows += [(task.name, _render_absent_row(task, self._snapshot)) for task in self._absent_tasks()]
        last = {name: place for place, (name, _) in enumerate(rows)}
        found: list[tuple[str, Row]] = []
        for place, (name, row) in enumerate(rows):
            found.append((name, row))
            if last[name] == place:
                found += [(name, copy) for copy in copies.pop(name, ())]
        return found + [(name, copy) for name, left in copies.items() for copy in left]

    def _render_standby_row(self, run: tuple[str, str, TaskSample]) -> Row:
        name, host, copy = run
        age = compute_task_age(copy, self._snapshot)
        usage = _render_usage_cells(copy, {})
        state = render_standby_state(copy)
        return (Cell(name, "name"), host, state, format_or_dash(age, format_duration), *usage)

    def _list_nodes(self, name: str) -> tuple[str, ...]:
        task = self._tasks.tasks.get(name)
        return list_node_names(task) if task is not None else ()

    def _render(self, rows: list[Row], look: RenderOptions, *, right: set[int]) -> str:
        first = self.list_problems()
        head_lines = [style_text(wrap_text(escape_unprintable(line), look), "bad", look) for line in first]
        table = render_columns(rows, look, right=right, wrap={2})
        measured = render_latency_rows(self._list_alive_runs())
        below = render_columns(measured, look, right=set(RIGHT_COLUMNS))
        return "".join(
            [self._render_header(look, len(first)), *head_lines, "\n", table, below and "\n" + below]
        )

    def _render_header(self, look: RenderOptions, problems: int) -> str:
        hosts = self._snapshot.hosts.values()
        running = {name for name, _, sample in self._list_alive_runs() if not is_restarting(sample)}
        warned = len(self._list_load_warnings())
        well = "no problem" + (f", {warned} warning{'s' * (warned != 1)} below" if warned else "")
        parts = [
            f"fleet {self._inventory.fleet}",
            f"{sum(name in running for name in self._tasks.tasks)}/{len(self._tasks.tasks)} tasks run",
            f"{sum(host.ok for host in hosts)}/{len(hosts)} hosts answer",
            f"{problems} problem{'s' * (problems != 1)}:" if problems else well,
        ]
        return render_header(parts, look)

    def list_problems(self) -> list[str]:
        """What is wrong now, the worst first."""
        failed = [
            f"{name} on {host}{', given up' if sample.given_up else ''}"
            for name, (host, sample) in self._failed.items()
        ]
        first = list_doubled_notes(self._snapshot) + list_unreachable_notes(self._snapshot)
        first += list_lost_task_notes(self._snapshot)
        if failed:
            first.append(f"{len(failed)} of {len(self._tasks.tasks)} tasks failed: {', '.join(failed)}")
        unhealthy = list_unhealthy_tasks(self._snapshot)
        if unhealthy:
            first.append(
                f"{len(unhealthy)} of {len(self._tasks.tasks)} tasks unhealthy: {', '.join(unhealthy)}"
            )
        restarting = list_restarting_tasks(self._snapshot)
        if restarting:
            first.append(
                f"{len(restarting)} of {len(self._tasks.tasks)} tasks restarting after a crash: "
                + ", ".join(restarting)
            )
        standbys = list_standby_faults(self._tasks, self._snapshot)
        if standbys:
            first.append(f"not ready as standby: {', '.join(standbys)}")
        return first + [
            f"{task} on {host} is cut off from {robot}: the link is down, and both answer edgectl"
            for task, host, robot in list_cut_off_tasks(self._tasks, self._snapshot)
        ]

    def _list_alive_runs(self) -> list[tuple[str, str, TaskSample]]:
        return [run for run in list_task_runs(self._snapshot) if run[2].state.alive]

    def notes(self) -> Sequence[str]:
        """The warnings that are not above the table, and remarks that stand in the rows of documents."""
        above = set(self.list_problems()) if self._list_named_rows() else set()
        none = [] if self._tasks.tasks or list_task_runs(self._snapshot) else ["no task"]
        warnings = [line for line in self.warnings() if line not in above]
        return [*none, *warnings, *list_task_remarks(self._snapshot), *self._list_need_notes()]

    def _render_run_row(self, run: tuple[str, str, TaskSample]) -> Row:
        name, host, sample = run
        demand = find_task_demand(name, host, self._snapshot, self._inventory, self._tasks)
        age = compute_task_age(sample, self._snapshot)
        return (
            Cell(name, "name"),
            host,
            Cell(format_task_state(sample), TASK_STATE_STYLES[sample.state]),
            format_or_dash(age, format_duration),
            *_render_usage_cells(sample, demand),
        )

    def _list_need_notes(self) -> list[str]:
        return [
            f"{name} needs {need}, which has failed"
            for name, task in self._tasks.tasks.items()
            for need in list_failed_needs(task, self._failed)
        ]

    def _describe_attention(self, name: str, sample: TaskSample) -> str:
        needs = list_failed_needs(self._tasks.tasks.get(name), self._failed)
        own = describe_attention(sample)
        return "; ".join([*([own] if own else []), *(f"needs {need}, which has failed" for need in needs)])

    def _absent_tasks(self) -> list[Task]:
        seen = {name for name, _, _ in list_task_runs(self._snapshot)}
        return [task for task in self._tasks.tasks.values() if task.name not in seen]

    def items(self) -> Sequence[Document]:
        """The same rows as JSON types, each with what needs attention."""
        cut_off: dict[tuple[str, str], list[str]] = {}
        for task, host, robot in list_cut_off_tasks(self._tasks, self._snapshot):
            cut_off.setdefault((task, host), []).append(robot)
        runs = [
            encode_run_row(
                name,
                host,
                sample,
                find_task_demand(name, host, self._snapshot, self._inventory, self._tasks),
                self._snapshot,
            )
            | self._encode_nodes(name)
            | _encode_cut_off(cut_off.get((name, host)))
            | {"attention": self._describe_attention(name, sample) or None}
            for name, host, sample in list_task_runs(self._snapshot)
        ]
        absent = [
            encode_absent_row(task, self._snapshot)
            | self._encode_nodes(task.name)
            | {"attention": _describe_absence(task, self._snapshot)}
            for task in self._absent_tasks()
        ]
        copies = [
            encode_standby_row(name, host, copy, {}, self._snapshot)
            | {"attention": describe_standby_fault(copy) or None}
            for name, host, copy in list_standby_runs(self._snapshot)
        ]
        return [*runs, *absent, *copies]

    def _encode_nodes(self, name: str) -> Document:
        nodes = self._list_nodes(name)
        return {"node_names": list(nodes)} if nodes else {}

    def warnings(self) -> Sequence[str]:
        """Tasks that run twice, at lost places or of other fleets, hosts without a reply, marks, usage above
        what is declared, and what the fleet lacks.
        """
        return [
            *list_snapshot_notes(self._snapshot),
            *list_operator_mark_notes(self._snapshot),
            *list_foreign_notes(self._snapshot),
            *self._list_load_warnings(),
            *list_latency_notes(self._list_alive_runs()),
        ]

    def _list_load_warnings(self) -> list[str]:
        overuses = find_overuses(self._inventory, self._tasks, self._snapshot)
        return [found.describe() for found in self._shortages] + [found.describe_run() for found in overuses]

    def names(self) -> Sequence[str]:
        """The tasks that run."""
        return [f"task/{task}" for task, _, sample in list_task_runs(self._snapshot) if sample.state.alive]


def _encode_cut_off(robots: Sequence[str] | None) -> Document:
    return {"cut_off_from": list(robots)} if robots else {}


def _render_usage_cells(sample: TaskSample, demand: Amounts) -> list[str]:
    cells = []
    for resource in RESOURCES:
        # No host tells what one task takes of a declared budget.
        used = sample.used[resource.name] if sample.state.alive and not resource.optional else None
        cells += [
            format_or_dash(used, resource.unit.format),
            format_or_dash(demand.get(resource.name), resource.unit.format),
        ]
    return cells


def _stack_demand_rows(rows: list[Row]) -> Iterator[Row]:
    """For a narrow terminal: the demands on a row of their own below the usage."""
    yield (*rows[0][:_FIRST_USAGE], *rows[0][_FIRST_USAGE::2])
    for row in rows[1:]:
        yield (*row[:_FIRST_USAGE], *row[_FIRST_USAGE::2])
        demands = row[_FIRST_USAGE + 1 :: 2]
        if any(demand != "-" for demand in demands):
            yield ("", "", "", "demand", *demands)


def _drop_usage_columns(rows: list[Row], look: RenderOptions) -> list[Row]:
    """The rows without the last resources that would stand below their row, away from their heading."""
    while len(rows[0]) > _FIRST_USAGE + 1 and not is_within_width(_with_short_states(rows), look):
        rows = [row[:-1] for row in rows]
    return rows


def _with_short_states(rows: Iterable[Row]) -> list[Row]:
    """The rows with the state that a column has room for at least: longer ones are wrapped."""
    return [(*row[:2], TaskState.COMPLETED, *row[3:]) for row in rows]


def _render_absent_row(task: Task, value: Snapshot) -> Row:
    known = resolve_absent_task(task, value)
    text = known.state + format_silence(known.contact, value.taken_at)
    state = Cell(text, "warn" if known.host else "dim")
    return (Cell(task.name, "name"), known.host or "-", state, *("-",) * (len(_HEAD) - 3))


def _describe_absence(task: Task, value: Snapshot) -> str | None:
    known = resolve_absent_task(task, value)
    if known.lost is not None:
        return describe_lost_place(known.lost)
    if known.host is None:
        return None if known.state == "completed" else known.state
    return f"{known.host} does not answer" + format_silence(known.contact, value.taken_at)
