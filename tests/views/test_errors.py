# SPDX-License-Identifier: Apache-2.0
"""Errors: position, line, caret, hint; the same records as JSON and as annotations."""

import json
from dataclasses import replace

from edgectl.errors import ConnectError, InputError, LockBusyError, Problem, StalePlanError
from edgectl.views import errors, github, gitlab

PROBLEM = Problem(
    file="tasks/a.yaml",
    line=9,
    column=7,
    code="EC012",
    message="unknown key demnd",
    hint="did you mean demand?",
    source="      demnd: {cpu: 1}",
    length=5,
)


def test_a_problem_shows_its_place() -> None:
    assert errors.render_error(InputError([PROBLEM])) == (
        "error[EC012]: tasks/a.yaml:9:7: unknown key demnd\n"
        "    9 |       demnd: {cpu: 1}\n"
        "      |       ^^^^^\n"
        "hint: did you mean demand?\n"
    )  # fmt: skip


def test_the_caret_stands_under_the_mistake_even_after_odd_characters() -> None:
    odd = Problem(file="a", line=1, column=3, code="", message="m", source="\t\x1bx: 1", length=1)
    line, caret = errors.render_problem(odd).splitlines()[1:3]
    assert line == "    1 | \\t\\x1bx: 1"
    assert line[caret.index("^")] == "x"


def test_a_stale_plan_lists_what_moved() -> None:
    text = errors.render_error(StalePlanError(["slam stopped", "edge2 is silent"]))
    assert text.splitlines()[1:3] == ["  slam stopped", "  edge2 is silent"]
    assert json.loads(errors.render_error_json(StalePlanError(["x"])))["changes"] == ["x"]


def test_json_names_the_kind_and_the_exit_code() -> None:
    document = json.loads(errors.render_error_json(LockBusyError("held by ana", hint="wait")))
    assert document["error"] == {
        "kind": "lock-busy",
        "message": "held by ana",
        "hint": "wait",
        "exit_code": 75,
    }
    assert json.loads(errors.render_error_json(InputError([PROBLEM])))["problems"][0]["line"] == 9


def test_an_error_of_a_host_names_it() -> None:
    assert (
        errors.render_error(ConnectError("connection refused", host="edge1"))
        == "error: edge1: connection refused\n"
    )
    assert errors.render_error(ConnectError("edge1 is off", host="edge1")) == "error: edge1 is off\n"


def test_github_annotations_escape_what_would_end_them() -> None:
    odd = Problem(
        file="a,b:c.yaml", line=2, column=3, code="EC1", message="100%\nsure", hint="", length=2, warning=True
    )
    assert (
        github.problems([odd])
        == "::warning file=a%2Cb%3Ac.yaml,line=2,col=3,endColumn=5,title=EC1::100%25%0Asure\n"
    )


def test_a_report_of_gitlab_knows_a_problem_again_when_it_has_moved() -> None:
    here = Problem(file="a.yaml", line=2, column=3, code="EC1", message="no", source="  x: 1", warning=True)
    moved, other = replace(here, line=9), replace(here, source="  y: 1")
    entries = json.loads(gitlab.render_report([here, moved, other]))
    assert entries[0]["severity"] == "minor"
    assert entries[0]["fingerprint"] == entries[1]["fingerprint"] != entries[2]["fingerprint"]
    assert [entry["location"]["lines"]["begin"] for entry in entries] == [2, 9, 2]


def test_a_problem_of_a_whole_file_has_a_line_for_gitlab() -> None:
    (entry,) = json.loads(
        gitlab.render_report([Problem(file="a.yaml", line=0, column=0, code="EC1", message="no")])
    )
    assert entry["location"]["lines"]["begin"] == 1
