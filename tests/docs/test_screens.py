# SPDX-License-Identifier: Apache-2.0
"""The pictures of docs/screens: they load nothing, and show what the commands print today."""

import re
from html import unescape
from pathlib import Path

import pytest

from tests.docs.cast_picture import render_cast
from tests.docs.recording import read_cast
from tests.docs.screens import (
    CAST,
    LIVE,
    OFFLINE,
    SCREENS,
    Screen,
    draw_screen,
    find_in_demo,
    mask_values,
    read_description,
    record_offline,
)

PICTURES = sorted(SCREENS.glob("*.svg"))
ANEW = "run: .venv/bin/python -m tests.docs.screens"


def test_every_screen_has_its_picture() -> None:
    names = {f"{screen.name}.svg" for screen in (*OFFLINE, *LIVE)}
    assert {path.name for path in PICTURES} == names | {"demo.svg"}


@pytest.mark.parametrize("path", PICTURES, ids=lambda path: path.stem)
def test_a_picture_loads_nothing_and_is_small(path: Path) -> None:
    text = path.read_text()
    assert len(text) < 150_000
    assert re.findall(r"https?://(?!www\.w3\.org/2000/svg)|@import|<script|<image|\bon\w+=", text) == []


@pytest.mark.parametrize("screen", OFFLINE, ids=lambda screen: screen.name)
def test_a_screen_shows_what_its_command_prints(screen: Screen, tmp_path: Path) -> None:
    shown = unescape(read_description((SCREENS / f"{screen.name}.svg").read_text()))
    now = f"$ edgectl {' '.join(screen.words)}\n{record_offline(screen, tmp_path)}"
    assert mask_values(shown) == mask_values(now), ANEW


@pytest.mark.parametrize("screen", LIVE, ids=lambda screen: screen.name)
def test_a_live_screen_is_that_of_the_recording(screen: Screen) -> None:
    drawn = draw_screen(screen, find_in_demo(screen, read_cast(CAST)))
    shown = read_description((SCREENS / f"{screen.name}.svg").read_text())
    assert shown == read_description(drawn), ANEW


def test_the_played_demo_is_the_recording() -> None:
    recording = read_cast(CAST)
    assert (SCREENS / "demo.svg").read_text() == render_cast(recording), ANEW
    times = [at for at, _ in recording.chunks]
    assert times == sorted(times)
    assert times[-1] < 120
