# SPDX-License-Identifier: Apache-2.0
"""Broken snapshot and plan files: each with its place, message and a hint."""

import json
import time
from pathlib import Path

import pytest

from edgectl.config.documents import load_plan, load_snapshot
from edgectl.errors import InputError, Problem
from edgectl.formats.document import dump_document
from edgectl.formats.kinds import PLAN_KIND, SNAPSHOT_KIND
from edgectl.model.assignment import (
    Decision,
    ExpectedLoad,
    RankedHost,
    Reason,
    Rejection,
    RejectionRule,
    UtilityTerms,
    Verdict,
)
from edgectl.model.inventory import Role
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.policy import Policy
from edgectl.model.resource import CPU, Usage
from edgectl.model.snapshot import (
    CapacitySource,
    HostSample,
    HostStatus,
    LinkSample,
    ResourceUsage,
    Snapshot,
    TaskSample,
    TaskState,
)
from tests.config.broken_files import locate

SNAPSHOT = Snapshot(
    taken_at=1_795_000_000.5,
    manager=ManagerState(
        managed=True,
        placements={"slam": Placement(host="edge1", since=1_794_999_000.0)},
        cordons=frozenset({"edge2"}),
    ),
    hosts={
        "edge1": HostSample(
            role=Role.EDGE,
            status=HostStatus.OK,
            usage={
                "cpu": ResourceUsage(capacity=4.0, used=1.5),
                "memory": ResourceUsage(capacity=4e9, used=1e9),
            },
            links={
                "robot1": LinkSample(
                    capacity_bytes_per_s=6.75e6, used_bytes_per_s=1e3, capacity_source=CapacitySource.MEASURED
                )
            },
            tasks={
                "slam": TaskSample(
                    state=TaskState.READY, pid=41, started_at=1_794_999_000.0, used=Usage(cpu=1.25)
                )
            },
        ),
        "edge2": HostSample(role=Role.EDGE, status=HostStatus.UNREACHABLE, error="no route"),
    },
)
DECISION = Decision(
    task="slam",
    verdict=Verdict.KEPT,
    reason=Reason.STILL_BEST,
    host="edge1",
    previous_host="edge1",
    total=0.5,
    ranking=(
        RankedHost(
            host="edge1",
            rank=1,
            total=0.5,
            terms=UtilityTerms(cpu=0.5, memory=0.5, network=0.5, task=0.5),
            feasible=True,
        ),
        RankedHost(
            host="edge2",
            rank=0,
            total=None,
            terms=UtilityTerms(cpu=None, memory=None, network=None, task=None),
            feasible=False,
            rejections=(
                Rejection(rule=RejectionRule.INSUFFICIENT, resource=CPU, demand=1.5, used=3.5, capacity=4.0),
            ),
        ),
    ),
)
PLAN = Plan(
    created_at=SNAPSHOT.taken_at,
    policy=Policy(),
    inventory_digest="sha256:aa",
    tasks_digest="sha256:bb",
    snapshot=SNAPSHOT,
    settled=True,
    steps=(Step(decision=DECISION, action=Action.KEEP),),
    expected={"edge1": ExpectedLoad(used=Usage(cpu=1.5, memory=1e9), links={"robot1": 1e3})},
)
TEXTS = {
    "snapshot": dump_document(SNAPSHOT_KIND.encode(SNAPSHOT)),
    "plan": dump_document(PLAN_KIND.encode(PLAN)),
}
LOADERS = {"snapshot": load_snapshot, "plan": load_plan}

# changed text, replacement, place of the problem (in the replacement), its code, its message, its hint
CASES = {
    "no cores": ("snapshot", '"capacity_cores": 4', '"capacity_cores": 0', "0", "EC202", "hosts.edge1.cpu.capacity_cores: must be above 0, not 0", "correct the value"),
    "negative use": ("snapshot", '"used_cores": 1.5', '"used_cores": -1', "-1", "EC202", "must be 0 or more, not -1", ""),
    "infinite": ("snapshot", '"capacity_bytes": 4000000000', '"capacity_bytes": 1e999', "1e999", "EC202", "must be a finite number", ""),
    "endless integer": ("snapshot", '"capacity_cores": 4', f'"capacity_cores": {"9" * 5000}', "9" * 5000, "EC201", "is not a finite number", "write a finite"),
    "integer beyond floats": ("snapshot", '"capacity_cores": 4', f'"capacity_cores": {"9" * 400}', "9" * 400, "EC202", "must be a finite number", ""),
    "not a number": ("snapshot", '"used_cores": 1.5', '"used_cores": NaN', "NaN", "EC201", "NaN is not a finite number", "write a finite number"),
    "text for a number": ("snapshot", '"capacity_cores": 4', '"capacity_cores": "4"', '"4"', "EC202", "must be a number, not a string", ""),
    "true for a number": ("snapshot", '"capacity_cores": 4', '"capacity_cores": true', "true", "EC202", "must be a number, not true or false", ""),
    "part of a pid": ("snapshot", '"pid": 41', '"pid": 41.5', "41.5", "EC202", "must be a whole number", ""),
    "unknown status": ("snapshot", '"status": "ok"', '"status": "okay"', '"okay"', "EC202", "unknown status: 'okay'", "write one of ok, unreachable"),
    "unknown source": ("snapshot", ': "measured"', ': "guessed"', '"guessed"', "EC202", "unknown capacity_source", "write one of declared, measured"),
    "instant": ("snapshot", '"taken_at": "2026', '"taken_at": "yesterday 2026', '"yesterday', "EC202", "taken_at: cannot be read as an instant", ""),
    "no such month": ("snapshot", '"taken_at": "2026', '"taken_at": "2026-13-01T00:00:00Z", "x": "2026', '"2026-13-01T00:00:00Z"', "EC202", "cannot be read as an instant", ""),
    "before year 1": ("snapshot", '"taken_at": "2026', '"taken_at": "0001-01-01T00:00:00+23:00", "x": "2026', '"0001-01-01T00:00:00+23:00"', "EC202", "cannot be read as an instant", ""),
    "null": ("snapshot", '"capacity_cores": 4', '"capacity_cores": null', "null", "EC202", "must not be null", ""),
    "no measurements": ("snapshot", '"cpu"', '"kpu"', None, "EC202", "hosts.edge1: cpu is missing", "add cpu"),
    "no hosts": ("snapshot", '"hosts"', '"host"', None, "EC202", "hosts is missing", "add hosts"),
    "key twice": ("snapshot", '"edge2": {', '"edge1": {', '"edge1": {', "EC005", "(first defined on line", "remove one"),
    "newer": ("snapshot", '"format_version": 2', '"format_version": 3', "3", "EC202", "snapshot of format_version 3; this edgectl reads 2", "update edgectl"),
    "older": ("snapshot", '"format_version": 2', '"format_version": 1', "1", "EC202", "snapshot of format_version 1", "write it again: edgectl probe --out FILE"),
    "no version": ("snapshot", '  "format_version": 2,\n', "", None, "EC202", "format_version is missing", "add format_version"),
    "cut off": ("snapshot", '"used_bytes": 1000000000', '"used_bytes"', None, "EC201", "not JSON: Expecting ':' delimiter", "edgectl probe --out"),
    "comma": ("snapshot", '"capacity_cores": 4,', '"capacity_cores": 4', None, "EC201", "not JSON: Expecting ',' delimiter", "edgectl probe --out"),
    "half a pair": ("snapshot", '"no route"', '"\\ud83d"', None, "EC201", "surrogates not allowed", ""),
    "list of hosts": ("snapshot", '"links": {', '"links": [{}], "x": {', "[", "EC202", "must be an object, not a list", ""),
    "memory": ("snapshot", '"managed": true', '"managed": 1', "1", "EC202", "manager.managed: must be true or false, not a number", ""),
    "cordons": ("snapshot", '"cordons": [\n      "edge2"', '"cordons": [\n      2', "2", "EC202", "manager.cordons.0: must be a string", ""),
    "unknown action": ("plan", '"action": "keep"', '"action": "kepe"', '"kepe"', "EC202", "decisions.0.action: unknown action", "write one of start"),
    "no digest": ("plan", '"tasks_digest"', '"task_digest"', None, "EC202", "tasks_digest is missing", "add tasks_digest"),
    "host is a number": ("plan", '"host": "edge1"', '"host": 1', "1", "EC202", "decisions.0.host: must be a string, not a number", ""),
    "no snapshot": ("plan", '"snapshot"', '"snap"', None, "EC202", "snapshot is missing", "add snapshot"),
    "ranking": ("plan", '"feasible": false', '"feasible": "no"', '"no"', "EC202", "decisions.0.ranking.1.feasible: must be true or false", ""),
    "rejection": ("plan", '"insufficient"', '"poor"', '"poor"', "EC202", "rejections.0.rule: unknown rule", "write one of unreachable"),
    "policy": ("plan", '"policy": "utility"', '"policy": "best"', '"best"', "EC202", "unknown policy", "write one of utility, paper"),
    "snapshot in a plan": ("plan", '"capacity_cores": 4', '"capacity_cores": 0', "0", "EC202", "snapshot.hosts.edge1.cpu.capacity_cores: must be above 0", ""),
}  # fmt: skip


def list_problems(kind: str, text: str, directory: Path) -> tuple[Problem, ...]:
    path = directory / f"{kind}.json"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        LOADERS[kind](path)
    return caught.value.problems


@pytest.mark.parametrize("name", CASES)
def test_a_broken_document_is_told_with_its_place(name: str, tmp_path: Path) -> None:
    kind, old, new, at, code, message, hint = CASES[name]
    text = TEXTS[kind]
    assert old in text
    broken = text.replace(old, new, 1)
    problem = next(p for p in list_problems(kind, broken, tmp_path) if p.code == code)
    assert message in problem.message
    assert hint in problem.hint
    assert problem.hint
    assert 1 <= problem.line <= broken.count("\n") + 1
    if at is not None:
        start = text.index(old) + new.index(at)
        assert (problem.line, problem.column) == locate(broken[:start] + "\0" + broken[start:], "\0")
        assert problem.length == min(400, len(at.split()[0].rstrip("{:"))) or name in ("instant", "key twice")


def test_what_we_write_is_read_back(tmp_path: Path) -> None:
    for kind, value in (("snapshot", SNAPSHOT), ("plan", PLAN)):
        (tmp_path / kind).write_text(TEXTS[kind])
        assert LOADERS[kind](tmp_path / kind) == value


def test_unknown_keys_are_left_alone(tmp_path: Path) -> None:
    document = json.loads(TEXTS["snapshot"])
    document["note"] = "by hand"
    document["hosts"]["edge1"]["fans"] = [1, 2]
    (tmp_path / "s.json").write_text(json.dumps(document))
    assert load_snapshot(tmp_path / "s.json") == SNAPSHOT


def test_an_unreachable_host_needs_only_role_and_status(tmp_path: Path) -> None:
    document = {
        "format_version": 2,
        "taken_at": "2026-11-21T08:00:00Z",
        "hosts": {"edge1": {"role": "edge", "status": "unreachable"}},
    }
    (tmp_path / "s.json").write_text(json.dumps(document))
    assert load_snapshot(tmp_path / "s.json").hosts["edge1"] == HostSample(
        role=Role.EDGE, status=HostStatus.UNREACHABLE
    )


def test_a_host_without_anything_is_told_in_full(tmp_path: Path) -> None:
    text = '{"format_version": 2, "taken_at": "2026-11-21T08:00:00Z", "hosts": {"edge1": {}, "edge2": 3}}'
    messages = sorted(problem.message for problem in list_problems("snapshot", text, tmp_path))
    assert messages == [
        "hosts.edge1: cpu is missing",
        "hosts.edge1: memory is missing",
        "hosts.edge1: role is missing",
        "hosts.edge1: status is missing",
        "hosts.edge2: must be an object, not a number",
    ]


@pytest.mark.parametrize(
    "text",
    [
        "[" * 200_000,
        '{"a":' * 100_000,
        "[" * 900 + "]" * 900,
        "",
        " ",
        "null",
        "[]",
        '"x"',
        "{",
        '{"a" 1}',
        "\0",
        "nul",
    ],
)
def test_what_is_no_document_is_refused_at_once(text: str, tmp_path: Path) -> None:
    begin = time.process_time()
    for kind in LOADERS:
        assert list_problems(kind, text, tmp_path)[0].line >= 1
    assert time.process_time() - begin < 5.0


def test_a_file_that_is_not_there_names_the_command_that_writes_it(tmp_path: Path) -> None:
    for load, command in ((load_snapshot, "edgectl probe --out"), (load_plan, "edgectl plan --out")):
        with pytest.raises(InputError) as caught:
            load(tmp_path / "none.json")
        assert (
            caught.value.problems[0].hint
            == f"name an existing file, or create one: {command} {tmp_path / 'none.json'}"
        )


def test_a_plan_for_a_snapshot_is_one_mistake(tmp_path: Path) -> None:
    snapshot, plan = tmp_path / "s.json", tmp_path / "p.json"
    snapshot.write_text(dump_document(SNAPSHOT_KIND.encode(SNAPSHOT)))
    plan.write_text(dump_document(PLAN_KIND.encode(PLAN)))
    for load, path, message in (
        (load_plan, snapshot, "this is a snapshot, not a plan"),
        (load_snapshot, plan, "this is a plan, not a snapshot"),
    ):
        with pytest.raises(InputError) as caught:
            load(path)
        assert [problem.message for problem in caught.value.problems] == [message]
