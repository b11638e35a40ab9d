# SPDX-License-Identifier: Apache-2.0
"""Usage of tasks, now and over the last samples, against their demand."""

from collections.abc import Iterable, Sequence

from edgectl.errors import describe_unseen_task
from edgectl.formats.document import Document, without_none
from edgectl.model.inventory import Inventory
from edgectl.model.point import TaskPoint
from edgectl.model.resource import CPU, RESOURCES, TASK_RESOURCES, Resource
from edgectl.model.snapshot import Snapshot, TaskSample, TaskState
from edgectl.model.task import Task, Tasks
from edgectl.names import natural_key
from edgectl.units import format_duration, format_instant
from edgectl.views import latency, metrics
from edgectl.views.glossary import get_flat_used_key, head
from edgectl.views.notes import list_snapshot_notes
from edgectl.views.output import ListView
from edgectl.views.output_format import WIDE_FORMATS
from edgectl.views.rows import compute_task_age, encode_run_row, find_task_demand
from edgectl.views.standbys import encode_standby_row, list_standby_runs, render_standby_state
from edgectl.views.state import TASK_STATE_STYLES, resolve_absent_task
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns
from edgectl.views.usage import (
    Amounts,
    format_or_dash,
    render_difference,
    render_with_sparklines,
    subtract_demand,
)

# Of the CPU the demand is always shown, of the others in the wide form.
_OTHER_TASK_RESOURCES = tuple(each for each in TASK_RESOURCES if each is not CPU)
_UNMEASURED_RESOURCES = tuple(each for each in RESOURCES if each not in TASK_RESOURCES)


def _list_columns(resource: Resource, *amounts: str) -> tuple[str, ...]:
    return tuple(f"{resource.name}.{amount}_{resource.unit.name}" for amount in amounts)


_TASK_HEAD = head(
    "task", "host", *_list_columns(CPU, "used", "demand", "excess"),
    *(column for each in _OTHER_TASK_RESOURCES for column in _list_columns(each, "used")), "age_s", "ready",
)  # fmt: skip
_WIDE_TASK_HEAD = head(
    *(column for each in _OTHER_TASK_RESOURCES for column in _list_columns(each, "demand", "excess")),
    *(column for each in _UNMEASURED_RESOURCES for column in _list_columns(each, "demand")), "restarts",
)  # fmt: skip
_RIGHT_COLUMNS = frozenset(range(2, len(_TASK_HEAD) - 1))
_WIDE_RIGHT_COLUMNS = frozenset(range(len(_TASK_HEAD), len(_TASK_HEAD) + len(_WIDE_TASK_HEAD)))


class TopTasksView(ListView):
    """Usage of each task that runs, against its demand, with its CPU over the last samples."""

    kind = "task-usage"
    formats = WIDE_FORMATS

    def __init__(
        self,
        snapshot: Snapshot,
        inventory: Inventory,
        tasks: Tasks,
        points: Iterable[TaskPoint],
        *,
        order: Sequence[int] | None = None,
        headers: bool = True,
    ) -> None:
        """``order``: the places of the tasks and copies, where they are sorted otherwise than by name."""
        self._snapshot, self._inventory, self._tasks = snapshot, inventory, tasks
        self._order, self._headers = order, headers
        self._points = group_points_by_task(points)

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per task; then latencies, and the metrics that applications report."""
        return self._render(look, wide=False)

    def wide(self, look: RenderOptions = PLAIN) -> str:
        """The table with demand and excess of memory and network."""
        return self._render(look, wide=True)

    def _render(self, look: RenderOptions, *, wide: bool) -> str:
        runs = _list_running_tasks(self._snapshot)
        if not runs and not _list_living_copies(self._snapshot):
            return ""
        rows: list[Row] = [(*_TASK_HEAD, *_WIDE_TASK_HEAD) if wide else _TASK_HEAD]
        histories: list[tuple[Sequence[float | None], float]] = []
        for name, host, sample in runs:
            demand = self._find_demand(name, host)
            task = self._tasks.tasks.get(name)
            rows.append(_render_top_task_row(name, host, sample, task, demand, self._snapshot, wide=wide))
            used = [point.used[CPU.name] for point in self._points.get(name, ())]
            histories.append((used, max([demand.get(CPU.name) or 0.0, *used])))
        for name, host, copy in _list_living_copies(self._snapshot):
            rows.append(_render_copy_row(name, host, copy, self._snapshot, wide=wide))
            histories.append(((), 0.0))
        right = _RIGHT_COLUMNS | _WIDE_RIGHT_COLUMNS if wide else _RIGHT_COLUMNS
        if self._order is not None:
            rows = [rows[0], *(rows[1 + place] for place in self._order)]
            histories = [histories[place] for place in self._order]
        body = render_with_sparklines(rows, histories, look, right=right, headers=self._headers)
        measured = latency.render_latency_rows(runs)
        below = [
            render_columns(measured, look, right=set(latency.RIGHT_COLUMNS)),
            render_columns(metrics.render_metrics_rows(runs), look),
        ]
        return "\n".join([body, *filter(None, below)])

    def _list_idle_notes(self) -> list[str]:
        """How many tasks do not run, and those of which it is not known because their host is silent."""
        running = {name for name, _, _ in _list_running_tasks(self._snapshot)}
        missing = [task for name, task in self._tasks.tasks.items() if name not in running]
        absent = {task.name: resolve_absent_task(task, self._snapshot) for task in missing}
        unseen = {task: known.host for task, known in absent.items() if known.host is not None}
        unknown = [
            f"not known: {describe_unseen_task(task, host)}"
            for task, host in unseen.items()
            if absent[task].lost is None
        ]
        idle = len(missing) - len(unseen)
        count = f"{idle} of {len(self._tasks.tasks)} tasks do not run: edgectl status"
        return [
            *unknown,
            *([count] if idle else []),
            *([] if running or idle else ["no task runs on a host that answers"]),
        ]

    def _find_demand(self, name: str, host: str) -> Amounts:
        return find_task_demand(name, host, self._snapshot, self._inventory, self._tasks)

    def items(self) -> Sequence[Document]:
        """The tasks as JSON types, each with its last samples, oldest first."""
        found = [
            encode_run_row(name, host, sample, self._find_demand(name, host), self._snapshot)
            | {"history": list(map(_encode_task_point, self._points.get(name, ())))}
            for name, host, sample in _list_running_tasks(self._snapshot)
        ] + [
            encode_standby_row(name, host, copy, {}, self._snapshot) | {"history": []}
            for name, host, copy in _list_living_copies(self._snapshot)
        ]
        return found if self._order is None else [found[place] for place in self._order]

    def warnings(self) -> Sequence[str]:
        """Tasks that do not run, and hosts without a reply."""
        runs = _list_running_tasks(self._snapshot)
        return [
            *self._list_idle_notes(),
            *list_snapshot_notes(self._snapshot),
            *latency.list_latency_notes(runs),
        ]


def group_points_by_task(points: Iterable[TaskPoint]) -> dict[str, list[TaskPoint]]:
    """Samples by task, in the order in which they come."""
    found: dict[str, list[TaskPoint]] = {}
    for point in points:
        found.setdefault(point.task, []).append(point)
    return found


def render_task_rows_of_host(value: Snapshot, inventory: Inventory, tasks: Tasks, *, on: str) -> list[Row]:
    """The tasks that run on one host, with headings and without the host; empty where nothing runs."""
    rows: list[Row] = [
        _render_top_task_row(
            name,
            host,
            sample,
            tasks.tasks.get(name),
            find_task_demand(name, host, value, inventory, tasks),
            value,
            wide=False,
        )
        for name, host, sample in _list_running_tasks(value)
        if host == on
    ]
    rows += [
        _render_copy_row(name, host, copy, value, wide=False)
        for name, host, copy in _list_living_copies(value)
        if host == on
    ]
    return [(row[0], *row[2:]) for row in (_TASK_HEAD, *rows)] if rows else []


def _list_running_tasks(value: Snapshot) -> list[tuple[str, str, TaskSample]]:
    runs = (
        (name, host, sample)
        for host, each in value.hosts.items()
        for name, sample in each.tasks.items()
        if sample.state.alive
    )
    return sorted(runs, key=lambda run: (natural_key(run[0]), natural_key(run[1])))


def _list_living_copies(value: Snapshot) -> list[tuple[str, str, TaskSample]]:
    return [run for run in list_standby_runs(value) if run[2].state.alive]


def _render_copy_row(name: str, host: str, copy: TaskSample, value: Snapshot, *, wide: bool) -> Row:
    """An inactive copy: what it uses, and ``standby`` in place of its readiness."""
    row = _render_top_task_row(name, host, copy, None, {}, value, wide=wide)
    place = len(_TASK_HEAD) - 1
    return (*row[:place], render_standby_state(copy), *row[place + 1 :])


def _render_top_task_row(
    name: str,
    host: str,
    sample: TaskSample,
    task: Task | None,
    demand: Amounts,
    value: Snapshot,
    *,
    wide: bool,
) -> Row:
    row: Row = (
        Cell(name, "name"),
        host,
        CPU.unit.format(sample.used[CPU.name]),
        *_render_demand_and_excess(CPU, sample, demand),
        *(each.unit.format(sample.used[each.name]) for each in _OTHER_TASK_RESOURCES),
        format_or_dash(compute_task_age(sample, value), format_duration),
        _render_readiness(sample, task),
    )
    if not wide:
        return row
    return (
        *row,
        *(cell for each in _OTHER_TASK_RESOURCES for cell in _render_demand_and_excess(each, sample, demand)),
        *(format_or_dash(demand.get(each.name), each.unit.format) for each in _UNMEASURED_RESOURCES),
        str(sample.restarts),
    )


def _render_demand_and_excess(resource: Resource, sample: TaskSample, demand: Amounts) -> Row:
    demanded, show = demand.get(resource.name), resource.unit.format
    excess = subtract_demand(sample, demand).get(resource.name)
    return format_or_dash(demanded, show), render_difference(excess, demanded, show)


def _render_readiness(sample: TaskSample, task: Task | None) -> Cell:
    """Yes or no where there is a readiness check."""
    if sample.state is TaskState.RUNNING:
        return Cell("no", "warn") if task is not None and task.ready is not None else Cell("-")
    return Cell("yes" if sample.state is TaskState.READY else "no", TASK_STATE_STYLES[sample.state])


def _encode_task_point(point: TaskPoint) -> Document:
    return without_none(
        at=format_instant(point.at),
        host=point.host,
        **{get_flat_used_key(each): point.used[each.name] for each in TASK_RESOURCES},
    )
