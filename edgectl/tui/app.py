# SPDX-License-Identifier: Apache-2.0
"""Live view: the keys over its tables, and one thread that probes the fleet periodically."""

import asyncio
import signal
import threading
import time
from collections.abc import Callable
from typing import ClassVar

from textual.app import SuspendNotSupported
from textual.binding import Binding, BindingType
from textual.widgets import Input

from edgectl.errors import EdgectlError
from edgectl.tui import rows
from edgectl.tui.backend import FleetBackend, FrameReceived, NoteChanged, TextLoaded
from edgectl.tui.screens import ConfirmScreen, TextScreen
from edgectl.tui.tables import FleetTables
from edgectl.tui.tree import render_task_tree

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


class TopApp(FleetTables):
    """The tables of a fleet, which is probed until the view ends."""

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
        super().__init__(first=first, unicode=unicode, clock=clock)
        self._work, self._every = work, every
        self._ended = threading.Event()
        self._again = threading.Event()

    def on_mount(self) -> None:
        """Start the probes; textual calls the handler of the tables, too."""
        self._install_signal_handlers()
        threading.Thread(target=self._look, daemon=True).start()

    def _install_signal_handlers(self) -> None:
        """SIGTERM and SIGHUP end the view as q does, with the terminal as it was."""
        for number in (signal.SIGTERM, signal.SIGHUP):
            asyncio.get_running_loop().add_signal_handler(number, self.exit)

    def on_unmount(self) -> None:
        """End the thread without waiting for a host that hangs."""
        self._ended.set()
        self._again.set()

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
