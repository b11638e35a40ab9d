# SPDX-License-Identifier: Apache-2.0
"""Every number of the worked example in docs/concepts/decision.md."""

from pathlib import Path

import pytest

import edgectl
from edgectl.config.weights import parse_weights
from edgectl.model.assignment import Assignment
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.policy import Policy, Preference
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample
from edgectl.model.task import Task
from tests.builders import (
    GI,
    NOW,
    a_link,
    a_robot,
    a_run,
    a_sample,
    a_snapshot,
    a_task,
    an_edge,
    an_inventory,
    some_tasks,
)
from tests.scheduler.fleets import decisions_by_task, list_terms, ranking_by_host, run_assign

PAGE = Path(edgectl.__file__).parent.parent / "docs/concepts/decision.md"
MB, LINK = 1e6, 10e6


def table(heading: str) -> list[dict[str, str]]:
    """The rows of the first table below a heading."""
    lines = PAGE.read_text().split(f"### {heading}\n")[1].splitlines()
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines[: _end(lines)]
        if line.startswith("|")
    ]
    return [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]


def _end(lines: list[str]) -> int:
    return next((n for n, line in enumerate(lines) if line.startswith("#")), len(lines))


def a_host(row: dict[str, str]) -> HostSample:
    slam = a_run(used=Usage(cpu=1.0, memory=0.4 * GI, network=0.5 * MB))
    return a_sample(
        cores=float(row["cores"]), used=float(row["used cores"]), memory=float(row["memory"]) * GI,
        used_memory=float(row["used memory"]) * GI,
        links={robot: a_link(LINK, float(row[f"link {robot}"]) * MB) for robot in ("robot1", "robot2")},
        tasks={"slam-robot1": slam} if row["host"] == "edge1" else {},
    )  # fmt: skip


def work(row: dict[str, str]) -> Task:
    return a_task(
        row["task"], cpu=row["cpu"] if row["cpu"].endswith("%") else float(row["cpu"]), memory=float(row["memory"]) * GI,
        throughput=float(row["throughput"]) * MB, robots=row["robots"].split(", "), needs=[] if row["needs"] == "-" else [row["needs"]],
        priority=float(row["priority"]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def assignment() -> Assignment:
    hosts = table("The hosts")
    edges = [an_edge(row["host"], cpu_limit=float(row["cpu limit"].rstrip("%")) / 100) for row in hosts]
    inventory = an_inventory(*edges, a_robot("robot1"), a_robot("robot2"))
    snapshot = a_snapshot({row["host"]: a_host(row) for row in hosts})
    return run_assign(inventory, some_tasks(*map(work, table("The tasks"))), snapshot)


def test_the_terms(assignment: Assignment) -> None:
    rows = table("The terms")
    found = decisions_by_task(assignment)
    assert [decision.task for decision in assignment.decisions] == list(
        dict.fromkeys(row["task"] for row in rows)
    )
    assert len(rows) == sum(len(decision.ranking) for decision in assignment.decisions)
    for row in rows:
        entry = ranking_by_host(found[row["task"]])[row["host"]]
        numbers = [float(row[name]) for name in ("UT_cpu", "UT_mem", "UT_net", "UT_task", "total")]
        assert list_terms(entry) == pytest.approx(numbers, abs=1e-12), row
        assert (
            outcome(found[row["task"]].host == row["host"], found[row["task"]].verdict, entry)
            == row["outcome"]
        )


def outcome(chosen: bool, verdict: str, entry: object) -> str:
    lacking = [f"{r.rule} {r.resource}" for r in entry.rejections]  # type: ignore[attr-defined]
    return str(verdict) if chosen else ", ".join(lacking)


def test_the_rows_stand_in_the_order_of_the_ranking(assignment: Assignment) -> None:
    rows = [(row["task"], row["host"]) for row in table("The terms")]
    assert rows == [
        (decision.task, entry.host) for decision in assignment.decisions for entry in decision.ranking
    ]


def test_the_load_after_the_plan(assignment: Assignment) -> None:
    for row in table("After the plan"):
        load = assignment.expected[row["host"]]
        numbers = [
            load.used["cpu"],
            load.used["memory"] / GI,
            load.links["robot1"] / MB,
            load.links["robot2"] / MB,
        ]
        assert numbers == pytest.approx(
            [float(row[name]) for name in ("used cores", "used memory", "link robot1", "link robot2")]
        )


def test_the_sentences_around_the_tables(assignment: Assignment) -> None:
    found = decisions_by_task(assignment)
    assert found["slam-robot1"].lead == pytest.approx(0.084375)
    assert (found["navigation-robot1"].reason.value, found["navigation-robot1"].subject) == (
        "with-predecessor",
        "slam-robot1",
    )
    assert assignment.settled


@pytest.mark.parametrize(
    "row", table("Moves worked by hand"), ids=lambda row: f"{row['gain']}: {row['outcome']}"
)
def test_the_moves(row: dict[str, str]) -> None:
    memory = ManagerState(
        managed=True, placements={"slam": Placement(host="edge1", since=NOW - float(row["here for s"]))},
        downtimes={("slam", "edge2"): numbers(row["measured s"])}, stays={"slam": numbers(row["past stays s"])},
    )  # fmt: skip
    snapshot = a_snapshot(
        edge1=a_sample(used=4 * float(row["gain"]), tasks={"slam": a_run()}), edge2=a_sample()
    )
    policy = Policy(weights=parse_weights("cpu"))
    inventory, tasks = (
        an_inventory(an_edge("edge1"), an_edge("edge2")),
        some_tasks(a_task("slam", downtime_cost=float(row["cost"]))),
    )
    decision = decisions_by_task(run_assign(inventory, tasks, snapshot, memory=memory, policy=policy))["slam"]
    assert decision.reason.value == row["outcome"]
    if decision.cost is None:
        assert (row["downtime s"], row["stay s"], float(row["gain needed"])) == ("-", "-", policy.move_margin)
    else:
        found = (decision.cost.downtime_s, decision.cost.stay_s, decision.cost.needed)
        assert found == pytest.approx(
            (float(row["downtime s"]), float(row["stay s"]), float(row["gain needed"])), abs=5e-5
        )


def numbers(cell: str) -> tuple[float, ...]:
    return () if cell == "-" else tuple(map(float, cell.split(", ")))


def test_every_linked_decision_record_exists() -> None:
    links = [part.split(")")[0] for part in PAGE.read_text().split("](")[1:]]
    assert links
    assert [
        link for link in links if not link.startswith("#") and not (PAGE.parent / link.split("#")[0]).exists()
    ] == []


@pytest.mark.parametrize("row", table("Reservations worked by hand"), ids=lambda row: row["reserved"])
def test_the_reservations(row: dict[str, str]) -> None:
    others, uses = float(row["others use"]), float(row["uses"])
    run = a_run(used=Usage(cpu=uses), started_at=NOW - float(row["runs for s"]))
    snapshot = a_snapshot(edge1=a_sample(used=others + uses, tasks={"slam": run}))
    tasks = some_tasks(a_task("a-new", cpu=0.5), a_task("slam", cpu=float(row["declared"])))
    found = decisions_by_task(run_assign(an_inventory(an_edge()), tasks, snapshot))["a-new"]
    assert found.ranking[0].terms["cpu"] == pytest.approx(float(row["term"]))
    assert found.ranking[0].feasible == (row["fits"] == "yes")
    assert 4.0 - others - 0.5 - 4.0 * float(row["term"]) == pytest.approx(float(row["reserved"]))


@pytest.mark.parametrize(
    "row", table("Overloads worked by hand"), ids=lambda row: f"{row['edge1 now']}: {row['outcome']}"
)
def test_the_overloads(row: dict[str, str]) -> None:
    run = a_run(used=Usage(cpu=1.0))
    snapshot = a_snapshot(
        edge1=a_sample(used=float(row["others on edge1"]) + 1.0, tasks={"slam": run}),
        edge2=a_sample(used=float(row["others on edge2"])),
    )
    policy = Policy(weights=parse_weights("cpu"))
    tasks = some_tasks(a_task(cpu=1.0))
    decision = run_assign(
        an_inventory(an_edge("edge1"), an_edge("edge2")), tasks, snapshot, policy=policy
    ).decisions[0]
    assert decision.reason.value == row["outcome"]
    terms = {host: entry.terms["cpu"] for host, entry in ranking_by_host(decision).items()}
    assert terms == pytest.approx({"edge1": float(row["edge1 now"]), "edge2": float(row["edge2 then"])})
    assert 1.0 - float(row["others on edge1"]) / 4.0 == pytest.approx(float(row["edge1 then"]))


@pytest.mark.parametrize(
    "row", table("Rules worked by hand"), ids=lambda row: f"{row['rule of t1 to t3']}, {row['cores']}"
)
def test_the_rules_between_tasks(row: dict[str, str]) -> None:
    key, _, value = row["rule of t1 to t3"].partition(": ")
    rule: dict[str, object] = {}
    if key in ("apart", "together"):
        rule = {key: (value.strip("[]"),)}
    elif key in ("spread", "group"):
        rule = {key: value}
    prefer = Preference(value) if key == "prefer" else Preference.SPREAD
    racks = {"edge1": "a", "edge2": "a", "edge3": "b"}
    found = run_assign(
        an_inventory(*(an_edge(edge, labels={"rack": rack}) for edge, rack in racks.items())),
        some_tasks(
            a_task("other", cpu=1.0),
            *(a_task(name, template="t", cpu=float(row["cores"]), **rule) for name in ("t1", "t2", "t3")),  # type: ignore[arg-type]
        ),
        a_snapshot(edge1=a_sample(), edge2=a_sample(), edge3=a_sample(cores=8.0)),
        policy=Policy(weights=parse_weights("cpu"), prefer=prefer),
    )
    hosts = {decision.task: decision.host or "-" for decision in found.decisions}
    assert hosts == {name: row[name] for name in ("other", "t1", "t2", "t3")}
