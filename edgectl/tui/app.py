# SPDX-License-Identifier: Apache-2.0
"""Live view: two tables, keys, and one thread that probes the fleet periodically."""

import asyncio
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.coordinate import Coordinate
from textual.events import Resize
from textual.message import Message
from textual.widgets import DataTable, Footer, Input, Static

from edgectl.errors import EdgectlError
from edgectl.tui import rows
from edgectl.tui.rows import Frame, TopRow
from edgectl.tui.screens import ConfirmScreen, TextScreen
from edgectl.views.text import escape_unprintable

_TEXTUAL_STYLES = {
    "good": "green",
    "bad": "red",
    "warn": "yellow",
    "dim": "bright_black",
    "bold": "bold",
    "name": "cyan",
}
_HELP = """\
tab      the other table
arrows   another line
/        only lines with a text; Enter keeps it, Esc clears it
s        sort by the next column
d        describe the line
l        log of the task, its last lines
c        cordon or uncordon the host of the line; asks first
q        quit

Everything is measured again every few seconds. Sparklines show
the newest samples of the history, the newest at the right: of a
host up to its capacity, of a task up to its demand or its own
highest.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetBackend:
    """Operations of the view; each is called in a thread of its own.

    ``frames`` yields a frame after each probe until the function that it is given, which waits in between,
    returns true. ``cordon`` cordons a host or uncordons it; None: nothing may be changed.
    """

    frames: Callable[[Callable[[], bool]], Iterator[Frame]]
    logs: Callable[[str], str]
    cordon: Callable[[str, bool], None] | None


class FrameReceived(Message):
    """A new frame."""

    def __init__(self, frame: Frame) -> None:
        super().__init__()
        self.frame = frame


class NoteChanged(Message):
    """A note for the user; empty clears it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.text = text


class TextLoaded(Message):
    """The text of a text screen."""

    def __init__(self, reader: TextScreen, text: str) -> None:
        super().__init__()
        self.reader, self.text = reader, text


class TopApp(App[None]):
    """Hosts above, tasks below."""

    CSS = """
    #head { height: 1; color: $text-muted; }
    #note { height: auto; max-height: 3; color: $warning; }
    #filter { height: 1; border: none; padding: 0; display: none; }
    #filter.asked { display: block; }
    DataTable { background: $surface; }
    #hosts { height: auto; max-height: 45%; margin-bottom: 1; }
    #tasks { height: 1fr; }
    """
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q", "quit", "Quit"),
        Binding("ctrl+c", "quit", show=False, priority=True),
        Binding("slash", "filter", "Filter"),
        Binding("s", "sort", "Sort"),
        Binding("d", "describe", "Describe"),
        Binding("l", "logs", "Logs"),
        Binding("c", "cordon", "Cordon"),
        Binding("question_mark", "help", "Help"),
        Binding("escape", "clear", show=False),
    ]

    def __init__(
        self, work: FleetBackend, *, every: float, first: str = "hosts", unicode: bool = True
    ) -> None:
        super().__init__()
        self._work, self._every, self._first, self._unicode = work, every, first, unicode
        self._frame: Frame | None = None
        self._width = 80
        self._wanted = ""
        self._orders = {"hosts": rows.HOST_ORDERS[0], "tasks": rows.TASK_ORDERS[0]}
        self._lines: dict[str, list[TopRow]] = {"hosts": [], "tasks": []}
        self._shapes: dict[str, tuple[list[str], list[int]]] = {}
        self._ended = threading.Event()
        self._again = threading.Event()

    # -- what is on the screen --

    def compose(self) -> ComposeResult:
        """Summary, two tables, note, filter and keys."""
        yield Static("measuring ..", id="head")
        yield DataTable(id="hosts", cursor_type="row")
        yield DataTable(id="tasks", cursor_type="row")
        yield Static(id="note")
        yield Input(id="filter", placeholder="only lines with ..", select_on_focus=False)
        yield Footer()

    def on_mount(self) -> None:
        """Start the probes."""
        self._install_signal_handlers()
        self._table(self._first).focus()
        threading.Thread(target=self._look, daemon=True).start()

    def _install_signal_handlers(self) -> None:
        """SIGTERM and SIGHUP end the view as q does, with the terminal as it was."""
        for number in (signal.SIGTERM, signal.SIGHUP):
            asyncio.get_running_loop().add_signal_handler(number, self.exit)

    def on_unmount(self) -> None:
        """End the thread without waiting for a host that hangs."""
        self._ended.set()
        self._again.set()

    def on_resize(self, event: Resize) -> None:
        """Fit the sparklines to the width."""
        self._width = event.size.width  # the size of the view itself still is the old one
        self._draw()

    def on_frame_received(self, message: FrameReceived) -> None:
        """Show a new frame."""
        self._frame = message.frame
        self._draw()

    def on_note_changed(self, message: NoteChanged) -> None:
        """Show a note."""
        if self._has_all_widgets:
            self.query_one("#note", Static).update(Text(escape_unprintable(message.text)))

    @property
    def _has_all_widgets(self) -> bool:
        """Whether all widgets exist: not before they are mounted, and not while the view ends."""
        return len(self.query("#head, #hosts, #tasks, #note")) == 4

    def _draw(self) -> None:
        if self._frame is None or not self._has_all_widgets:
            return
        self._fill(
            "hosts", rows.HOST_TITLES, rows.build_host_rows(self._frame, self._width, unicode=self._unicode)
        )
        self._fill(
            "tasks", rows.TASK_TITLES, rows.build_task_rows(self._frame, self._width, unicode=self._unicode)
        )
        self._summarise(self._frame)

    def _summarise(self, frame: Frame) -> None:
        unreachable = f" ({frame.unreachable} unreachable)" if frame.unreachable else ""
        orders = ", ".join(f"{table} by {order}" for table, order in self._orders.items())
        shown = f" · only {self._wanted!r}" if self._wanted else ""
        hosts, tasks = len(frame.snapshot.hosts), len(frame.tasks.tasks)
        text = f"{hosts} hosts{unreachable} · {tasks} tasks · {orders}{shown}"
        self.query_one("#head", Static).update(Text(text))

    def _fill(self, name: str, titles: Sequence[str], lines: list[TopRow]) -> None:
        """Put the lines into a table; build it anew only if rows, their order or the widths changed."""
        shown = rows.select_rows(lines, self._wanted, self._orders[name])
        shape = ([line.key for line in shown], rows.compute_table_widths(lines, titles))
        at, self._lines[name] = self._line(name), shown
        with self.batch_update():
            if shape == self._shapes.get(name):
                self._renew(self._table(name), shown)
            else:
                self._shapes[name] = shape
                self._build(self._table(name), titles, shape[1], shown, at)

    def _renew(self, table: DataTable[Text], shown: list[TopRow]) -> None:
        for row, line in enumerate(shown):
            for column, text in enumerate(_render_cells(line)):
                if table.get_cell_at(Coordinate(row, column)) != text:
                    table.update_cell_at(Coordinate(row, column), text)

    def _build(
        self,
        table: DataTable[Text],
        titles: Sequence[str],
        widths: list[int],
        shown: list[TopRow],
        at: TopRow | None,
    ) -> None:
        """Build the table; the cursor stays on its row."""
        table.clear(columns=True)
        for title, width in zip(titles, widths, strict=True):
            table.add_column(Text(title), width=width)
        table.add_rows(_render_cells(line) for line in shown)
        place = next(
            (number for number, line in enumerate(shown) if at is not None and line.key == at.key), 0
        )
        table.move_cursor(row=place, animate=False)

    def _table(self, name: str) -> DataTable[Text]:
        return self.query_one(f"#{name}", DataTable)

    def _line(self, name: str) -> TopRow | None:
        """The line under the cursor of a table."""
        place = self._table(name).cursor_row
        return self._lines[name][place] if place < len(self._lines[name]) else None

    @property
    def _focused_table(self) -> str:
        """The table with the focus."""
        return "tasks" if self._table("tasks").has_focus else "hosts"

    # -- keys --

    def action_filter(self) -> None:
        """Show the filter."""
        box = self.query_one("#filter", Input)
        box.add_class("asked")
        box.focus()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Filter while it is typed."""
        self._wanted = event.value
        self._draw()

    def on_input_submitted(self, _event: Input.Submitted) -> None:
        """Back to the tables."""
        self.query_one("#filter").remove_class("asked")
        self.query_one("#tasks" if not self._lines["hosts"] else "#hosts").focus()

    def action_clear(self) -> None:
        """Clear the filter and the note."""
        self.query_one("#filter", Input).value = ""
        self.query_one("#filter").remove_class("asked")
        self.post_message(NoteChanged(""))
        if not self._table("tasks").has_focus:
            self.query_one("#hosts").focus()

    def action_sort(self) -> None:
        """Sort the table by its next column."""
        orders = rows.HOST_ORDERS if self._focused_table == "hosts" else rows.TASK_ORDERS
        self._orders[self._focused_table] = orders[
            (orders.index(self._orders[self._focused_table]) + 1) % len(orders)
        ]
        self._draw()

    def action_help(self) -> None:
        """Show the keys."""
        self.push_screen(TextScreen("Keys", _HELP))

    def action_describe(self) -> None:
        """Describe the selected row."""
        line = self._line(self._focused_table)
        if line is not None and self._frame is not None:
            self.push_screen(
                TextScreen(line.task or str(line.host), rows.render_row_details(self._frame, line))
            )

    def action_logs(self) -> None:
        """Fetch the log of the task."""
        line = self._line(self._focused_table)
        if line is None or line.task is None:
            self.post_message(NoteChanged("a host has no log; choose a task (Tab)"))
            return
        reader, task = TextScreen(f"log of {line.task}", "loading ..", at_end=True), line.task
        self.push_screen(reader)

        def load() -> None:
            try:
                text = self._work.logs(task) or "nothing was printed"
            except EdgectlError as error:
                text = error.message
            self.post_message(TextLoaded(reader, text))

        self._run_in_thread(load)

    def on_text_loaded(self, message: TextLoaded) -> None:
        """Show it, unless the screen was closed."""
        if message.reader.is_attached:
            message.reader.show(message.text)

    def action_cordon(self) -> None:
        """Cordon or uncordon the selected host, after a question."""
        line, cordon = self._line(self._focused_table), self._work.cordon
        if line is None or line.host is None or self._frame is None:
            return
        if cordon is None:
            self.post_message(NoteChanged("--readonly: nothing is changed"))
            return
        host, manager = line.host, self._frame.snapshot.manager
        close = manager is None or host not in manager.cordons
        question = f"{'Cordon' if close else 'Uncordon'} {host}?"

        def answered(yes: bool | None) -> None:  # noqa: FBT001, textual calls it so
            if yes:
                self._run_in_thread(lambda: self._set_cordon(cordon, host, close=close))

        self.push_screen(ConfirmScreen(question), answered)

    def _set_cordon(self, cordon: Callable[[str, bool], None], host: str, *, close: bool) -> None:
        cordon(host, close)
        self.post_message(NoteChanged(f"{host} {'cordoned' if close else 'uncordoned'}"))
        self._again.set()

    # -- threads --

    def _run_in_thread(self, act: Callable[[], object]) -> None:
        """Run ``act`` in a thread of its own; show its error as a note."""

        def work() -> None:
            try:
                act()
            except EdgectlError as error:
                self.post_message(NoteChanged(error.message))

        threading.Thread(target=work, daemon=True).start()

    def _look(self) -> None:
        """Probe until the view ends."""
        while not self._ended.is_set():
            try:
                for frame in self._work.frames(self._wait):
                    self.post_message(FrameReceived(frame))
            except EdgectlError as error:
                self.post_message(NoteChanged(error.message))
                self._wait()

    def _wait(self) -> bool:
        """Wait for the next probe; whether the view has ended."""
        self._again.wait(self._every)
        self._again.clear()
        return self._ended.is_set()


def _render_cells(line: TopRow) -> list[Text]:
    """Cells with control characters of hosts escaped."""
    return [Text(escape_unprintable(cell.text), _TEXTUAL_STYLES.get(cell.style, "")) for cell in line.cells]
