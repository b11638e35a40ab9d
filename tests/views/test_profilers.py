# SPDX-License-Identifier: Apache-2.0
"""The profilers as a person and as a program sees them."""

import json
from dataclasses import replace

import yaml

from edgectl.model.profiler import Profiler, ProfilerState
from edgectl.model.resource import Usage
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.profilers import ProfilersView
from edgectl.views.text import RenderOptions
from tests.views.fixtures import show

RUNNING = Profiler(
    host="edge1", state=ProfilerState.RUNNING, pid=32101, age=3725.0, every=1.0, period=1.0, samples=3725, sample_age=0.41,
    used=Usage(cpu=0.0023, memory=11 << 20), ttl=3600.0, ttl_left=3599.2,
)  # fmt: skip
FOUND = (
    RUNNING,
    replace(RUNNING, host="edge2", period=2.5, sample_age=None),
    replace(RUNNING, host="robot1", state=ProfilerState.ALREADY_RUNNING, current=False),
    Profiler(host="robot2", state=ProfilerState.NOT_RUNNING, detail="the host was rebooted"),
    Profiler(host="robot3", state=ProfilerState.UNREACHABLE, error="no route", hint="look at the cable"),
)


def test_the_table_fits_80_columns_and_says_what_to_do() -> None:
    table = show(ProfilersView(FOUND))
    rows, notes = table.splitlines()[:6], table.splitlines()[6:]
    assert max(map(len, rows)) <= 80
    assert rows[0].split() == [
        "HOST",
        "STATE",
        "PID",
        "AGE",
        "EVERY",
        "SAMPLE",
        "AGE",
        "CPU",
        "MEMORY",
        "TTL",
        "LEFT",
    ]
    assert rows[1].split() == [
        "edge1",
        "running",
        "32101",
        "1h02m",
        "1.0s",
        "0.4s",
        "2m",
        "11.0Mi",
        "59m59s",
    ]
    assert rows[4].split() == ["robot2", "not-running", *"-------"]
    assert [note.split(":")[1].strip() for note in notes] == ["edge2", "robot1", "robot2", "robot3"]
    assert "every 2.5s instead of 1.0s" in notes[0]
    assert notes[3].endswith("no route (look at the cable)")
    assert "\x1b" not in table
    assert "\x1b" in render_view(
        ProfilersView(FOUND), OutputFormat.TABLE, RenderOptions(colour=True, width=80)
    )


def test_the_document_has_what_there_is() -> None:
    document = json.loads(render_view(ProfilersView(FOUND), OutputFormat.JSON))
    assert document["kind"] == "profiler"
    assert document["items"][0]["cpu"] == {"used_cores": 0.0023}
    assert document["items"][1]["sample_age_s"] is None
    assert document["items"][3] == {
        "host": "robot2",
        "state": "not-running",
        "detail": "the host was rebooted",
    }
    assert document["items"][4] == {
        "host": "robot3",
        "state": "unreachable",
        "error": "no route",
        "hint": "look at the cable",
    }
    assert yaml.safe_load(render_view(ProfilersView(FOUND), OutputFormat.YAML)) == document


def test_names_are_of_living_ones() -> None:
    assert (
        render_view(ProfilersView(FOUND), OutputFormat.NAME)
        == "profiler/edge1\nprofiler/edge2\nprofiler/robot1\n"
    )
