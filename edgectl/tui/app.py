# SPDX-License-Identifier: Apache-2.0
"""Live view: tables of hosts, tasks and links, keys, and one thread that probes the fleet periodically."""

import asyncio
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from rich.text import Text
from textual.app import App, ComposeResult, SuspendNotSupported
from textual.binding import Binding, BindingType
from textual.coordinate import Coordinate
from textual.events import Resize
from textual.message import Message
from textual.widgets import DataTable, Footer, Input, Static

from edgectl.errors import EdgectlError
from edgectl.tui import rows
from edgectl.tui.rows import Frame, TopRow
from edgectl.tui.screens import ConfirmScreen, TextScreen
from edgectl.tui.tree import render_task_tree
from edgectl.units import format_duration
from edgectl.views.text import escape_unprintable

_TEXTUAL_STYLES = {
    "good": "green",
    "bad": "red",
    "warn": "yellow",
    "dim": "bright_black",
    "bold": "bold",
    "name": "cyan",
}
# Head, health, note and keys.
_FRAME_LINES = 4
_HELP = """\
tab      next table        arrows   another line
/        only lines with a text; Enter keeps it, Esc clears it
o        order by the next column
d        describe the line
l        log of the task, its last lines
e        explain why the task is where it is
t        tree of tasks and what they need
r        restart the task; asks first
x        drain the host of the line; asks first
c        cordon or uncordon the host of the line; asks first
s        shell on the host of the line
q        quit

Sparklines show the newest samples, the newest at the right: of
a host up to its capacity, of a task up to its demand or its own
highest.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetBackend:
    """Operations of the view; each is called in a thread of its own.

    ``frames`` yields a frame after each probe until the function that it is given, which waits in between,
    returns true. ``cordon`` cordons a host or uncordons it; ``restart`` restarts a task, ``drain`` empties a
    host, and both say what came of it; None: nothing may be changed. ``open_shell`` opens a shell on a host
    in the terminal, which the view leaves to it, and gives its exit code.
    """

    frames: Callable[[Callable[[], bool]], Iterator[Frame]]
    logs: Callable[[str], str]
    explain: Callable[[str], str]
    cordon: Callable[[str, bool], None] | None
    restart: Callable[[str], str] | None
    drain: Callable[[str], str] | None
    open_shell: Callable[[str], int] | None


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
    """Hosts above, then tasks and links, and the tree of tasks in what is left."""

    CSS = """
    #head { height: 1; text-style: bold; text-wrap: nowrap; text-overflow: ellipsis; }
    #health { height: 1; text-wrap: nowrap; text-overflow: ellipsis; }
    #note { height: auto; max-height: 3; color: $warning; }
    #filter { height: 1; border: none; padding: 0; display: none; }
    #filter.asked { display: block; }
    DataTable { background: $surface; }
    #hosts { height: auto; max-height: 30%; }
    #tasks { height: auto; max-height: 45%; }
    #links { height: auto; max-height: 30%; }
    #rest { height: 1fr; color: $text-muted; overflow: hidden; }
    #tasks.full { height: 1fr; max-height: 100%; }
    #links.full { max-height: 20%; }
    .empty { display: none; }
    """
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("q", "quit", "Quit"),
        Binding("ctrl+c", "quit", show=False, priority=True),
        Binding("slash", "filter", show=False),
        Binding("o", "sort", show=False),
        Binding("d", "describe", "Describe"),
        Binding("l", "logs", "Logs"),
        Binding("e", "explain", "Why"),
        Binding("t", "tree", "Tree"),
        Binding("r", "restart", "Restart"),
        Binding("x", "drain", "Drain"),
        Binding("c", "cordon", show=False),
        Binding("s", "shell", "Shell"),
        Binding("question_mark", "help", "Help"),
        Binding("escape", "clear", show=False),
    ]

    def __init__(
        self,
        work: FleetBackend,
        *,
        every: float,
        first: str = "hosts",
        unicode: bool = True,
        clock: Callable[[], float] = time.time,
    ) -> None:
        super().__init__()
        self._clock = clock
        self._tree: TextScreen | None = None
        self._work, self._every, self._first, self._unicode = work, every, first, unicode
        self._frame: Frame | None = None
        self._width = 80
        self._wanted = ""
        self._orders = {
            "hosts": rows.HOST_ORDERS[0],
            "tasks": rows.TASK_ORDERS[0],
            "links": rows.LINK_ORDER,
        }
        self._lines: dict[str, list[TopRow]] = {"hosts": [], "tasks": [], "links": []}
        self._shapes: dict[str, tuple[list[str], list[int]]] = {}
        self._ended = threading.Event()
        self._again = threading.Event()

    # -- what is on the screen --

    def compose(self) -> ComposeResult:
        """Summary, health, three tables, tree, note, filter and keys."""
        yield Static("measuring ..", id="head")
        yield Static(id="health")
        yield DataTable(id="hosts", cursor_type="row")
        yield DataTable(id="tasks", cursor_type="row")
        yield DataTable(id="links", cursor_type="row")
        yield Static(id="rest")
        yield Static(id="note")
        yield Input(id="filter", placeholder="only lines with ..", select_on_focus=False)
        yield Footer()

    def on_mount(self) -> None:
        """Start the probes."""
        self._install_signal_handlers()
        self._table(self._first).focus()
        self.set_interval(1.0, self._show_head)
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
        if not self.screen_stack:
            return False
        base = self.screen_stack[0]
        return len(base.query("#head, #health, #hosts, #tasks, #links, #rest, #note")) == 7

    def _draw(self) -> None:
        if self._frame is None or not self._has_all_widgets:
            return
        self._fill(
            "hosts", rows.HOST_TITLES, rows.build_host_rows(self._frame, self._width, unicode=self._unicode)
        )
        self._fill(
            "tasks", rows.TASK_TITLES, rows.build_task_rows(self._frame, self._width, unicode=self._unicode)
        )
        self._fill("links", rows.LINK_TITLES, rows.build_link_rows(self._frame))
        self._table("links").set_class(not self._lines["links"], "empty")
        if self._tree is not None and self._tree.query("#text"):
            self._tree.show(render_task_tree(self._frame, unicode=self._unicode))
        self._show_rest()
        self._show_health(self._frame)
        self._show_head()

    def _show_rest(self) -> None:
        """Fill what the tables leave: the tree of tasks, then the selected line in full."""
        if self._frame is None or not self._has_all_widgets:
            return
        full = sum(len(lines) + 1 for lines in self._lines.values()) + _FRAME_LINES > self.size.height
        for name in ("tasks", "links"):
            self._table(name).set_class(full, "full")
        self._base("#rest").set_class(full, "empty")
        parts = [] if self._wanted else [render_task_tree(self._frame, unicode=self._unicode)]
        line = self._line(self._focused_table)
        if line is not None:
            parts.append(rows.render_row_details(self._frame, line))
        self._base("#rest").update(Text(escape_lines("\n\n".join(parts))))

    def on_data_table_row_highlighted(self, _event: DataTable.RowHighlighted) -> None:
        """Show another line in full."""
        self._show_rest()

    def _base(self, selector: str) -> Static:
        """A widget of the view itself, whatever screen is above it."""
        return self.screen_stack[0].query_one(selector, Static)

    def _show_head(self) -> None:
        """Fleet, clock and age of the sample, every second."""
        frame = self._frame
        if frame is None or not self._has_all_widgets:
            return
        now = self._clock()
        age = max(0, round(now - frame.snapshot.taken_at))
        unreachable = f" ({frame.unreachable} unreachable)" if frame.unreachable else ""
        orders = [f"{table} by {self._orders[table]}" for table in ("hosts", "tasks")]
        parts = [
            f"Fleet {frame.inventory.fleet}",
            time.strftime("%H:%M:%S", time.localtime(now)),
            f"sample {f'{age}s' if age < 60 else format_duration(age)} old",
            *([f"only {self._wanted!r}"] if self._wanted else []),
            *(order for order in orders if not order.endswith(" name")),
            f"{len(frame.snapshot.hosts)} hosts{unreachable}, {len(frame.tasks.tasks)} tasks",
        ]
        self._base("#head").update(Text(" · ".join(parts)))

    def _show_health(self, frame: Frame) -> None:
        """Number of problems, and the worst one."""
        found = rows.list_problems(frame)
        more = f"{len(found)} problems: " if len(found) > 1 else ""
        text = escape_unprintable(more + found[0]) if found else "no problem"
        self._base("#health").update(Text(text, "red" if found else "green"))

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
        return self.screen_stack[0].query_one(f"#{name}", DataTable)

    def _line(self, name: str) -> TopRow | None:
        """The line under the cursor of a table."""
        place = self._table(name).cursor_row
        return self._lines[name][place] if place < len(self._lines[name]) else None

    @property
    def _focused_table(self) -> str:
        """The table with the focus."""
        return next((name for name in ("tasks", "links") if self._table(name).has_focus), "hosts")

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
        table = self._focused_table
        orders = {"hosts": rows.HOST_ORDERS, "tasks": rows.TASK_ORDERS}.get(table, (rows.LINK_ORDER,))
        self._orders[table] = orders[(orders.index(self._orders[table]) + 1) % len(orders)]
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
        self._read_about_task("log", self._work.logs, at_end=True)

    def action_explain(self) -> None:
        """Explain the placement of the task."""
        self._read_about_task("explanation", self._work.explain)

    def _read_about_task(self, what: str, read: Callable[[str], str], *, at_end: bool = False) -> None:
        """Fetch a text about the selected task and show it."""
        task = self._get_selected_task(what)
        if task is None:
            return
        reader = TextScreen(f"{what} of {task}", "loading ..", at_end=at_end)
        self.push_screen(reader)

        def load() -> None:
            try:
                text = read(task) or "nothing was printed"
            except EdgectlError as error:
                text = error.message
            self.post_message(TextLoaded(reader, text))

        self._run_in_thread(load)

    def on_text_loaded(self, message: TextLoaded) -> None:
        """Show it, unless the screen was closed."""
        if message.reader.is_attached:
            message.reader.show(message.text)

    def action_tree(self) -> None:
        """Show the tree of tasks in full; it follows the samples."""
        if self._frame is not None:
            tree = render_task_tree(self._frame, unicode=self._unicode)
            self._tree = TextScreen("Tasks below those that they need", tree)
            self.push_screen(self._tree)

    def action_cordon(self) -> None:
        """Cordon or uncordon the selected host, after a question."""
        host, cordon = self._get_selected_host(), self._work.cordon
        if host is None or self._frame is None:
            return
        manager = self._frame.snapshot.manager
        close = manager is None or host not in manager.cordons

        def act() -> str:
            if cordon is not None:
                cordon(host, close)
            return f"{host} {'cordoned' if close else 'uncordoned'}"

        self._act_after_yes(f"{'Cordon' if close else 'Uncordon'} {host}", cordon and act)

    def action_drain(self) -> None:
        """Drain the selected host, after a question."""
        host, drain = self._get_selected_host(), self._work.drain
        if host is not None:
            self._act_after_yes(f"Cordon {host} and move its tasks away", drain and (lambda: drain(host)))

    def action_restart(self) -> None:
        """Restart the selected task, after a question."""
        task, restart = self._get_selected_task("restart"), self._work.restart
        if task is not None:
            self._act_after_yes(f"Restart {task}", restart and (lambda: restart(task)))

    def _act_after_yes(self, what: str, act: Callable[[], str] | None) -> None:
        """Ask, with the fleet's name; then act in a thread and say what came of it."""
        if act is None:
            self.post_message(NoteChanged("--readonly: nothing is changed"))
            return
        fleet = self._frame.inventory.fleet if self._frame is not None else ""

        def work() -> None:
            self.post_message(NoteChanged(act()))
            self._again.set()

        def answered(yes: bool | None) -> None:  # noqa: FBT001, textual calls it so
            if yes:
                self.post_message(NoteChanged(f"{what} ..."))
                self._run_in_thread(work)

        self.push_screen(ConfirmScreen(f"{what} (fleet {fleet})?"), answered)

    def action_shell(self) -> None:
        """Leave the terminal to a shell on the selected host."""
        host, shell = self._get_selected_host(), self._work.open_shell
        if host is None:
            return
        if shell is None:
            self.post_message(NoteChanged("--readonly: no shell"))
            return
        try:
            with self.suspend():
                code = shell(host)
        except (SuspendNotSupported, OSError) as error:
            self.post_message(NoteChanged(f"no shell on {host}: {error}"))
        else:
            self.post_message(NoteChanged(f"the shell on {host} ended with {code}" if code else ""))
        self._again.set()

    def _get_selected_host(self) -> str | None:
        """The host of the line under the cursor."""
        line = self._line(self._focused_table)
        return line.host if line is not None else None

    def _get_selected_task(self, what: str) -> str | None:
        """The task of the line under the cursor; without one, a note."""
        line = self._line(self._focused_table)
        if line is None or line.task is None:
            self.post_message(NoteChanged(f"{what} needs a task; choose one (Tab)"))
            return None
        return line.task

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


def escape_lines(text: str) -> str:
    """The lines with control characters of hosts escaped."""
    return "\n".join(map(escape_unprintable, text.split("\n")))


def _render_cells(line: TopRow) -> list[Text]:
    """Cells with control characters of hosts escaped."""
    return [Text(escape_unprintable(cell.text), _TEXTUAL_STYLES.get(cell.style, "")) for cell in line.cells]
