# SPDX-License-Identifier: Apache-2.0
"""The line that names the hosts that are waited for, on a real terminal."""

import contextlib
import io
import os
import pty
import select
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from edgectl.views.wait_line import WaitLine, pause_wait, show_wait
from tests.builders import a_sample
from tests.pace import patience

HOSTS = ["zeta", "yak", "xu", "wolf", "vole"]


@contextlib.contextmanager
def open_terminal(monkeypatch: pytest.MonkeyPatch, **variables: str) -> Iterator[int]:
    """The other end of a terminal that is stderr."""
    ours, theirs = pty.openpty()
    for name, value in {"TERM": "xterm", **variables}.items():
        monkeypatch.setenv(name, value)
    with os.fdopen(theirs, "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", stream)
        yield ours
    os.close(ours)


def read_until(descriptor: int, text: str) -> str:
    seen, end = "", time.monotonic() + patience(30)
    while text not in seen:
        assert time.monotonic() < end, seen
        if select.select([descriptor], [], [], 0.1)[0]:
            seen += os.read(descriptor, 4096).decode()
    return seen


def test_after_a_second_the_line_names_who_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_terminal(monkeypatch) as terminal:
        with show_wait(HOSTS) as line:
            assert line is not None
            line("zeta", a_sample(), 0.1)
            assert not select.select([terminal], [], [], 0.2)[0], "what is quick draws nothing"
            assert "1 of 5 hosts asked; waiting for yak, xu, wolf, .." in read_until(terminal, "..")
            line("xu", a_sample(), 1.5)
            assert "2 of 5 hosts asked; waiting for yak, wolf, vole" in read_until(terminal, "vole")
        assert read_until(terminal, "\x1b[2K").endswith("\r\x1b[2K"), "nothing of it stays"


def test_a_host_that_ends_while_the_line_is_drawn_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    class SlowTerminal(io.StringIO):
        """Its first flush waits until the test goes on."""

        begun, go_on = threading.Event(), threading.Event()

        def flush(self) -> None:
            self.begun.set()
            assert self.go_on.wait(patience(30))

    terminal, line = SlowTerminal(), WaitLine(HOSTS)
    monkeypatch.setattr(sys, "stderr", terminal)
    calls = [line.draw, lambda: line("zeta", a_sample(), 0.1)]
    threads = [threading.Thread(target=call) for call in calls]
    threads[0].start()
    assert terminal.begun.wait(patience(30))
    threads[1].start()
    threads[1].join(0.2)
    terminal.go_on.set()
    for thread in threads:
        thread.join()
    assert terminal.getvalue().endswith("1 of 5 hosts asked; waiting for yak, xu, wolf, ..")


def test_a_password_prompt_has_the_terminal_for_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_terminal(monkeypatch) as terminal:
        with show_wait(HOSTS) as line, pause_wait():
            assert line is not None
            assert not select.select([terminal], [], [], 1.5)[0]
        assert not select.select([terminal], [], [], 0.1)[0]


@pytest.mark.parametrize("variables", [{"CI": "true"}, {"TERM": "dumb"}])
def test_where_nothing_is_drawn(variables: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    with open_terminal(monkeypatch, **variables), show_wait(HOSTS) as line:
        assert line is None
