# SPDX-License-Identifier: Apache-2.0
"""Screens above the two tables: a text, and a question."""

from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.screen import ModalScreen
from textual.widgets import Static

from edgectl.views.text import decode_log_output


class TextScreen(ModalScreen[None]):
    """Text with a title; it may be set later."""

    CSS = """
    TextScreen { align: center middle; }
    TextScreen > Vertical { width: 90%; height: 85%; border: round $primary; padding: 0 1; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,enter", "dismiss", "Close"), Binding("end", "end"), Binding("home", "home"),
    ]  # fmt: skip

    def __init__(self, title: str, text: str = "", *, at_end: bool = False) -> None:
        super().__init__()
        self._head, self._text, self._at_end = title, text, at_end

    def compose(self) -> ComposeResult:
        """One scrolled text in a frame."""
        with Vertical() as box:
            box.border_title = Text(self._head)
            box.border_subtitle = "Esc closes"
            with VerticalScroll():
                yield Static(id="text")

    def on_mount(self) -> None:
        """Show what is there."""
        self.show(self._text)

    def show(self, text: str) -> None:
        """Show ``text``, with control characters of a host escaped."""
        self.query_one("#text", Static).update(Text(decode_log_output(text.encode("utf-8", "replace"))))
        if self._at_end:
            self.query_one(VerticalScroll).scroll_end(animate=False)

    def action_end(self) -> None:
        """To the last line."""
        self.query_one(VerticalScroll).scroll_end(animate=False)

    def action_home(self) -> None:
        """To the first line."""
        self.query_one(VerticalScroll).scroll_home(animate=False)


class ConfirmScreen(ModalScreen[bool]):
    """Yes or no; anything but y is a no."""

    CSS = """
    ConfirmScreen { align: center middle; }
    ConfirmScreen > Static { width: 60; height: auto; border: round $warning; padding: 1 2; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("y", "answer(True)", "Yes"), Binding("n,escape,q,enter", "answer(False)", "No"),
    ]  # fmt: skip

    def __init__(self, question: str) -> None:
        super().__init__()
        self._question = question

    def compose(self) -> ComposeResult:
        """The question in a frame."""
        yield Static(Text(f"{self._question}\n\ny yes   n no"))

    def action_answer(self, answer: bool) -> None:  # noqa: FBT001, textual calls it so
        """Close with the answer."""
        self.dismiss(answer)
