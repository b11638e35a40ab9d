# SPDX-License-Identifier: Apache-2.0
"""Live view of a watch: its text, and the screen that shows it."""

import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterator

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Reason
from edgectl.model.cycle import Cycle
from edgectl.model.plan import Action, Step
from edgectl.model.resource import CPU, HOST_RESOURCES, TASK_RESOURCES
from edgectl.model.snapshot import HostSample, ResourceUsage, TaskSample
from edgectl.units import format_duration
from edgectl.views.glossary import head_of_resource
from edgectl.views.reasons import describe_reason
from edgectl.views.sparkline import render_bar, render_sparkline
from edgectl.views.state import TASK_STATE_STYLES, format_task_state
from edgectl.views.text import (
    PLAIN,
    Cell,
    RenderOptions,
    Row,
    detect_render_options,
    escape_unprintable,
    render_columns,
    style_text,
    wrap_text,
)
from edgectl.views.watch_cycle import WatchTally, add_cycle_to_tally

# Of the CPU the screen shows the last cycles, of the others a bar.
_OTHER_HOST_RESOURCES = tuple(each for each in HOST_RESOURCES if each is not CPU)
_HOST_HEAD: Row = ("HOST", "STATUS", "CPU", "", *map(head_of_resource, _OTHER_HOST_RESOURCES), "TASKS")
_TASK_HEAD = ("", "TASK", "HOST", "STATE", *(each.title for each in TASK_RESOURCES), "DECISION")
_TASK_RIGHT_COLUMNS = frozenset(range(4, 4 + len(TASK_RESOURCES)))
_KEY_HELP = "q quit   p plan now   a pause"
_HIGH_SHARE = 0.9
# From this width on there is room for longer sparklines and for every reason.
_WIDE_COLUMNS = 120
_CALM_REASONS = frozenset(
    (Reason.STILL_BEST, Reason.STILL_FITS, Reason.ONLY_FEASIBLE, Reason.PINNED, Reason.NEVER_MOVED)
)
_HEAD_LINES, _FOOT_LINES, _MAX_PAST_LINES = 2, 2, 5


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchTitle:
    """The fixed part of the first line: name of the fleet, weights, and whether plans are applied."""

    fleet: str
    weights: str
    applies: bool


def render_watch_screen(
    title: WatchTitle,
    tally: WatchTally,
    now: float,
    *,
    paused: bool = False,
    rows: int = 24,
    look: RenderOptions = PLAIN,
) -> str:
    """All lines of the screen, at most ``rows``. ``now``: s since 1970."""
    tasks = _render_watch_tasks(tally, look)
    past = _render_past_lines(tally, min(_MAX_PAST_LINES, max(1, rows // 5)), look)
    room = rows - _HEAD_LINES - _FOOT_LINES - len(past) - 2
    shown_hosts = _render_watch_hosts(tally, now, max(3, room - len(tasks), room // 2), look)
    shown_tasks = _truncate_lines(tasks, max(2, room - len(shown_hosts)))
    lines = [
        _render_watch_header(title, tally, now, paused, look),
        "",
        *shown_hosts,
        "",
        *shown_tasks,
        "",
        *past,
        "",
        style_text(_KEY_HELP, "dim", look),
    ]
    return "\n".join(lines[:rows])


def _render_watch_header(
    title: WatchTitle,
    tally: WatchTally,
    now: float,
    paused: bool,  # noqa: FBT001
    look: RenderOptions,
) -> str:
    dot = " · " if look.unicode else " | "
    ago = "" if tally.moved_at is None else f" (last {format_duration(max(0.0, now - tally.moved_at))} ago)"
    parts = [
        style_text(escape_unprintable(title.fleet), "bold", look),
        f"weights {title.weights}",
        "applies" if title.applies else "plans only",
        style_text("paused", "warn", look) if paused else _format_next_cycle(tally, now),
        f"moves {tally.moves}{ago}",
        f"steady {tally.steady} {'cycle' if tally.steady == 1 else 'cycles'}",
    ]
    return dot.join(parts)


def _format_next_cycle(tally: WatchTally, now: float) -> str:
    if tally.last is None:
        return "first cycle"
    left = 0.0 if tally.due is None else tally.due - now
    return f"next in {math.ceil(left)}s" if left > 0 else "working"


def _render_watch_hosts(tally: WatchTally, now: float, room: int, look: RenderOptions) -> list[str]:
    """At most ``room`` lines. Hosts that have none are not rendered: of many that is most of a drawing."""
    hosts = list(tally.snapshot.hosts.items()) if tally.snapshot is not None else []
    passed_s = 0.0 if tally.snapshot is None else max(0.0, now - tally.snapshot.taken_at)
    shown = hosts if len(hosts) < room else hosts[: room - 2]
    rows = [_HOST_HEAD, *(_render_watch_host_row(name, host, passed_s, tally, look) for name, host in shown)]
    lines = render_columns(rows, RenderOptions(colour=look.colour), right={3}).splitlines()
    return lines if shown == hosts else [*lines, _format_rest(len(hosts) - len(shown))]


def _render_watch_host_row(
    name: str, host: HostSample, passed_s: float, tally: WatchTally, look: RenderOptions
) -> Row:
    """``passed_s``: since the snapshot, in which the sample had its age already."""
    strip = render_sparkline(
        tally.shares.get(name, ()), 1.0, 12 if _is_narrow(look) else 40, unicode=look.unicode
    )
    if not host.measured:
        unknown = ("-",) * len(HOST_RESOURCES)
        return (
            Cell(name, "name"), Cell(host.status.value, "bad"), strip, *unknown, Cell(host.error, "bad"),
        )  # fmt: skip
    share = host.usage[CPU.name].share
    running = [task for task, sample in host.tasks.items() if sample.state.alive]
    return (
        Cell(name, "name"),
        Cell(f"{host.status.value}, {format_duration(host.sample_age_s + passed_s)} old", "good"),
        strip,
        Cell(f"{share:.0%}", "bad" if share > _HIGH_SHARE else ""),
        *(_render_usage_bar(host.usage.get(each.name), look) for each in _OTHER_HOST_RESOURCES),
        str(len(running)) if _is_narrow(look) else " ".join(running) or "-",
    )


def _render_usage_bar(usage: ResourceUsage | None, look: RenderOptions) -> Cell:
    if usage is None:
        return Cell("-")
    bar = render_bar(usage.share, 8, unicode=look.unicode)
    return Cell(f"{bar} {usage.share:4.0%}", "bad" if usage.share > _HIGH_SHARE else "")


def _render_watch_tasks(tally: WatchTally, look: RenderOptions) -> list[str]:
    rows: list[Row] = [_TASK_HEAD]
    cycle = tally.last
    steps = cycle.plan.steps if cycle is not None and cycle.plan is not None else ()
    found = {
        name: (host, task)
        for host, sample in (tally.snapshot.hosts.items() if tally.snapshot is not None else ())
        for name, task in sample.tasks.items()
    }
    decided = {step.task: step for step in steps}
    resting = frozenset(cycle.resting) if cycle is not None else frozenset()
    # What is calm comes last, where lines may be left out.
    names = sorted(dict.fromkeys((*decided, *found)), key=lambda name: _is_calm(decided.get(name)))
    rows += [
        _render_watch_task_row(
            name, found.get(name), decided.get(name), resting=name in resting, brief=_is_narrow(look)
        )
        for name in names
    ]
    return (
        render_columns(rows, look, right=_TASK_RIGHT_COLUMNS).splitlines()
        if len(rows) > 1
        else ["No tasks yet."]
    )


def _render_watch_task_row(
    name: str,
    found: tuple[str, TaskSample] | None,
    step: Step | None,
    *,
    resting: bool,
    brief: bool,
) -> Row:
    """``brief``: without the reason of a task that stays as it is."""
    symbol, why = (step.action.symbol, describe_reason(step)) if step is not None else ("", "-")
    if brief and _is_calm(step):
        why = why.partition(":")[0]
    why = f"left alone for a while, because its last action failed; {why}" if resting else why
    if found is None:
        return (symbol, Cell(name, "name"), "-", "-", *("-",) * len(TASK_RESOURCES), why)
    host, sample = found
    return (
        symbol,
        Cell(name, "name"),
        host,
        Cell(format_task_state(sample), TASK_STATE_STYLES[sample.state]),
        *(each.unit.format(sample.used[each.name]) for each in TASK_RESOURCES),
        why,
    )


def _is_calm(step: Step | None) -> bool:
    """Whether the task stays as it is, for a reason that nobody has to read."""
    kept = step is not None and step.action is Action.KEEP and step.decision.reason in _CALM_REASONS
    return step is None or step.action is Action.NONE or kept


def _is_narrow(look: RenderOptions) -> bool:
    return (look.width or 80) < _WIDE_COLUMNS


def _render_past_lines(tally: WatchTally, count: int, look: RenderOptions) -> list[str]:
    """The newest in at most ``count`` lines, each whole: its end may be the command that is needed."""
    lines: list[str] = []
    for at, text in reversed(tally.past):
        begin = time.strftime("%H:%M:%S", time.localtime(at))
        wrapped = wrap_text(f"{begin} {text}", look, indent=len(begin) + 1).splitlines()
        if lines and len(lines) + len(wrapped) > count:
            break
        lines[:0] = [style_text(begin, "dim", look) + wrapped[0].removeprefix(begin), *wrapped[1:]]
    return lines or [style_text("No events yet.", "dim", look)]


def _truncate_lines(lines: list[str], room: int) -> list[str]:
    """``lines``; where not all fit, the last one is the number of the others."""
    return lines if len(lines) <= room else [*lines[: room - 1], _format_rest(len(lines) - room + 1)]


def _format_rest(count: int) -> str:
    return f"and {count} more"


class WatchScreen:
    """State of the live view: updated with each cycle, read by the thread that draws."""

    def __init__(self, title: WatchTitle, paused: Callable[[], bool]) -> None:
        self._title = title
        self._paused = paused
        self._tally = WatchTally()

    def show(self, cycle: Cycle) -> None:
        """Add one more cycle."""
        self._tally = add_cycle_to_tally(self._tally, cycle)

    def text(self, rows: int) -> str:
        """The screen now."""
        return render_watch_screen(
            self._title,
            self._tally,
            time.time(),
            paused=self._paused(),
            rows=rows,
            look=detect_render_options(sys.stdout),
        )


@contextlib.contextmanager
def show_watch_screen(screen: WatchScreen) -> Iterator[None]:
    """Draw ``screen`` twice a second on the alternate screen of the terminal, until the context ends."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(file=sys.stdout)

    def drawn() -> Text:
        return Text.from_ansi(screen.text(console.size.height), no_wrap=True, overflow="ellipsis")

    with Live(
        console=console,
        screen=True,
        get_renderable=drawn,
        refresh_per_second=2,
        redirect_stdout=False,
        redirect_stderr=False,
    ):
        yield
