# SPDX-License-Identifier: Apache-2.0
"""The doctor's findings as a person sees them: at 80 and 160 columns, in colour and without, and in a pipe."""

import json

import pytest
import yaml

from edgectl.model.diagnosis import Diagnosis, Finding, Severity
from edgectl.views.diagnosis import DiagnosisView
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.text import RenderOptions

LONG = "RemoveIPC=yes and jetson does not linger: shared memory is removed at the last logout, and ROS 2 stops communicating"
FOUND = Diagnosis(
    findings=(
        Finding(host=None, check="disk", level=Severity.OK, message="10.0Gi of 28.0Gi free for /state"),
        Finding(
            host="edge1",
            check="logind",
            level=Severity.WARNING,
            message=LONG,
            remedy="on edge1: sudo loginctl enable-linger jetson",
        ),
        Finding(
            host="edge2",
            check="reachability",
            level=Severity.FAILED,
            message="connection \x1b[2Jrefused",
            remedy="switch edge2 on",
        ),
    )
)
PIPED = f"""this machine
ok    disk          10.0Gi of 28.0Gi free for /state

edge1
warn  logind        {LONG}
                    fix: on edge1: sudo loginctl enable-linger jetson

edge2
FAIL  reachability  connection \\x1b[2Jrefused
                    fix: switch edge2 on

3 checks: 1 failed, 1 warning.
"""


def shown(**look: object) -> str:
    return render_view(DiagnosisView(FOUND), OutputFormat.TABLE, RenderOptions(**look))  # type: ignore[arg-type]


def test_in_a_pipe_nothing_is_cut_and_all_is_ascii() -> None:
    assert shown() == PIPED
    assert shown().isascii()


@pytest.mark.parametrize("width", [80, 160])
def test_on_a_terminal_nothing_passes_the_edge_and_nothing_is_lost(width: int) -> None:
    lines = shown(width=width, unicode=True).splitlines()
    assert max(map(len, lines)) <= width
    assert [line[0] for line in lines if line[:3] in ("✓  ", "!  ", "✗  ")] == ["✓", "!", "✗"]
    assert " ".join(" ".join(lines).split()) == " ".join(
        PIPED.replace("ok  ", "✓ ").replace("warn ", "! ").replace("FAIL ", "✗ ").split()
    )  # fmt: skip


def test_colour_carries_no_meaning_of_its_own() -> None:
    import re

    coloured = shown(colour=True, unicode=True)
    assert "\x1b[31m✗\x1b[0m" in coloured
    assert re.sub(r"\x1b\[[0-9]+m", "", coloured) == shown(unicode=True)


def test_the_document() -> None:
    document = json.loads(render_view(DiagnosisView(FOUND), OutputFormat.JSON))
    assert document["kind"] == "finding"
    assert document["items"][0] == {
        "host": None,
        "check": "disk",
        "level": "ok",
        "message": "10.0Gi of 28.0Gi free for /state",
    }
    assert document["items"][1]["hint"] == "on edge1: sudo loginctl enable-linger jetson"
    assert yaml.safe_load(render_view(DiagnosisView(FOUND), OutputFormat.YAML)) == document
