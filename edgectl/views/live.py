"""The live view of a watch: pure text for what is known, and the screen that shows it until it is left."""

import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from edgectl.model.cycle import Cycle
from edgectl.model.plan import Step
from edgectl.model.snapshot import HostSample, TaskSample
from edgectl.units import format_bytes, format_cores, format_duration, format_rate
from edgectl.views.reasons import reason
from edgectl.views.rounds import Tally, tallied
from edgectl.views.spark import bar, spark
from edgectl.views.state import STATES, phrase
from edgectl.views.text import PLAIN, Cell, Look, Row, columns, harmless, look_of, paint

_KEYS = "q quit   p plan now   a pause"
_HOT = 0.9
_HEAD, _FOOT, _PAST = 2, 2, 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Title:
    """What stands in the first line whatever happens: the fleet's name, the weights, and whether plans are carried out."""

    fleet: str
    variant: str
    applies: bool


def frame(title: Title, tally: Tally, now: float, *, paused: bool = False, rows: int = 24, look: Look = PLAIN) -> str:
    """All lines of the screen, at most ``rows``. ``now``: s since 1970."""
    hosts, tasks = _hosts(tally, look), _tasks(tally, look)
    past = _past(tally, min(_PAST, max(1, rows // 5)), look)
    room = rows - _HEAD - _FOOT - len(past) - 2
    shown_hosts = _cut(hosts, max(3, room - len(tasks), room // 2))
    shown_tasks = _cut(tasks, max(2, room - len(shown_hosts)))
    lines = [_header(title, tally, now, paused, look), "", *shown_hosts, "", *shown_tasks, "", *past, "", paint(_KEYS, "dim", look)]
    return "\n".join(lines[:rows])


def _header(title: Title, tally: Tally, now: float, paused: bool, look: Look) -> str:  # noqa: FBT001
    dot = " · " if look.unicode else " | "
    ago = "" if tally.moved_at is None else f" (last {format_duration(max(0.0, now - tally.moved_at))} ago)"
    parts = [
        paint(harmless(title.fleet), "bold", look),
        f"variant {title.variant}",
        "applies" if title.applies else "plans only",
        paint("paused", "warn", look) if paused else _next(tally, now),
        f"moves {tally.moves}{ago}",
        f"steady {tally.steady} {'cycle' if tally.steady == 1 else 'cycles'}",
    ]
    return dot.join(parts)


def _next(tally: Tally, now: float) -> str:
    if tally.last is None:
        return "first cycle"
    left = 0.0 if tally.due is None else tally.due - now
    return f"next in {math.ceil(left)}s" if left > 0 else "working"


def _hosts(tally: Tally, look: Look) -> list[str]:
    rows: list[Row] = [("HOST", "STATUS", "CPU", "", "MEMORY", "TASKS")]
    for name, host in tally.snapshot.hosts.items() if tally.snapshot is not None else ():
        rows.append(_host(name, host, tally, look))
    return columns(rows, Look(colour=look.colour), right={3}).splitlines()


def _host(name: str, host: HostSample, tally: Tally, look: Look) -> Row:
    strip = spark(tally.shares.get(name, ()), 1.0, 12 if (look.width or 80) < 120 else 40, unicode=look.unicode)
    if host.cpu is None or host.memory is None:
        return (Cell(name, "name"), Cell(host.status.value, "bad"), strip, "-", "-", Cell(host.error, "bad"))
    share, memory = host.cpu.used_cores / host.cpu.cores, host.memory.used_bytes / host.memory.total_bytes
    running = [task for task, sample in host.tasks.items() if sample.state.alive]
    return (
        Cell(name, "name"),
        Cell(host.status.value, "good"),
        strip,
        Cell(f"{share:.0%}", "bad" if share > _HOT else ""),
        Cell(f"{bar(memory, 8, unicode=look.unicode)} {memory:4.0%}", "bad" if memory > _HOT else ""),
        " ".join(running) or "-",
    )


def _tasks(tally: Tally, look: Look) -> list[str]:
    rows: list[Row] = [("", "TASK", "HOST", "STATE", "CPU", "MEMORY", "NET", "DECISION")]
    cycle = tally.last
    steps = cycle.plan.steps if cycle is not None and cycle.plan is not None else ()
    found = {
        name: (host, task)
        for host, sample in (tally.snapshot.hosts.items() if tally.snapshot is not None else ())
        for name, task in sample.tasks.items()
    }
    decided = {step.task: step for step in steps}
    resting = frozenset(cycle.resting) if cycle is not None else frozenset()
    rows += [_task(name, found.get(name), decided.get(name), name in resting) for name in dict.fromkeys((*decided, *found))]
    return columns(rows, Look(colour=look.colour), right={4, 5, 6}).splitlines() if len(rows) > 1 else ["No tasks yet."]


def _task(name: str, found: tuple[str, TaskSample] | None, step: Step | None, resting: bool) -> Row:  # noqa: FBT001
    symbol, why = (step.action.symbol, reason(step)) if step is not None else ("", "-")
    why = f"left alone for a while, because its last action failed; {why}" if resting else why
    if found is None:
        return (symbol, Cell(name, "name"), "-", "-", "-", "-", "-", why)
    host, sample = found
    return (
        symbol,
        Cell(name, "name"),
        host,
        Cell(phrase(sample), STATES[sample.state]),
        format_cores(sample.used_cores),
        format_bytes(sample.used_bytes),
        format_rate(sample.used_bytes_per_s),
        why,
    )


def _past(tally: Tally, count: int, look: Look) -> list[str]:
    lines = [f"{paint(time.strftime('%H:%M:%S', time.localtime(at)), 'dim', look)} {text}" for at, text in tally.past[-count:]]
    return lines or [paint("Nothing happened yet.", "dim", look)]


def _cut(lines: list[str], room: int) -> list[str]:
    """``lines``, of which the last says how many more there are where not all fit."""
    return lines if len(lines) <= room else [*lines[: room - 1], f"and {len(lines) - room + 1} more"]


class Screen:
    """What the live view knows. It is told of each cycle, and asked for its text by the thread that draws."""

    def __init__(self, title: Title, paused: Callable[[], bool]) -> None:
        self._title = title
        self._paused = paused
        self._tally = Tally()

    def show(self, cycle: Cycle) -> None:
        """Take one more cycle."""
        self._tally = tallied(self._tally, cycle)

    def text(self, rows: int) -> str:
        """The screen now."""
        return frame(self._title, self._tally, time.time(), paused=self._paused(), rows=rows, look=look_of(sys.stdout))


@contextlib.contextmanager
def live(screen: Screen) -> Iterator[None]:
    """Draw ``screen`` twice a second on standard output, on a screen of its own, until this is left; then the terminal is as before."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(file=sys.stdout)

    def drawn() -> Text:
        return Text.from_ansi(screen.text(console.size.height), no_wrap=True, overflow="ellipsis")

    with Live(console=console, screen=True, get_renderable=drawn, refresh_per_second=2, redirect_stdout=False, redirect_stderr=False):
        yield
