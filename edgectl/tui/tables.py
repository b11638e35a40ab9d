# SPDX-License-Identifier: Apache-2.0
"""Tables, head, health and note of the live view, drawn from its newest frame."""

import time
from collections.abc import Callable, Sequence

from rich.text import Text
from textual.app import App, ComposeResult
from textual.coordinate import Coordinate
from textual.events import Resize
from textual.widgets import DataTable, Footer, Input, Static

from edgectl.tui import rows
from edgectl.tui.backend import FrameReceived, NoteChanged
from edgectl.tui.rows import Frame, TopRow
from edgectl.tui.screens import TextScreen
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


class FleetTables(App[None]):
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

    def __init__(self, *, first: str, unicode: bool, clock: Callable[[], float]) -> None:
        super().__init__()
        self._clock = clock
        self._tree: TextScreen | None = None
        self._first, self._unicode = first, unicode
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
        """Focus the first table, and keep the age of the sample up to date."""
        self._table(self._first).focus()
        self.set_interval(1.0, self._show_head)

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
        self._base("#rest").update(Text(_escape_lines("\n\n".join(parts))))

    def on_data_table_row_highlighted(self, _event: DataTable.RowHighlighted) -> None:
        """Show another line in full."""
        self._show_rest()

    def _base(self, selector: str) -> Static:
        """A widget of the view itself, whatever screen is above it."""
        return self.screen_stack[0].query_one(selector, Static)

    def _show_head(self) -> None:
        """Fleet, clock and age of the oldest sample, every second."""
        frame = self._frame
        if frame is None or not self._has_all_widgets:
            return
        now = self._clock()
        age = max(0, round(now - frame.oldest_at))
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


def _escape_lines(text: str) -> str:
    """The lines with control characters of hosts escaped."""
    return "\n".join(map(escape_unprintable, text.split("\n")))


def _render_cells(line: TopRow) -> list[Text]:
    """Cells with control characters of hosts escaped."""
    return [Text(escape_unprintable(cell.text), _TEXTUAL_STYLES.get(cell.style, "")) for cell in line.cells]
