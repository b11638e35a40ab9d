# SPDX-License-Identifier: Apache-2.0
"""Operations behind the live view, and the messages that its threads post to it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from textual.message import Message

from edgectl.tui.rows import Frame
from edgectl.tui.screens import TextScreen


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
