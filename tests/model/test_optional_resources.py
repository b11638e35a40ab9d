# SPDX-License-Identifier: Apache-2.0
"""GPU, power, battery and heat, from the inventory to the explanation."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.config.weights import parse_weights
from edgectl.errors import InputError
from edgectl.executor.diff import plan_from_assignment
from edgectl.experiments.recorded_snapshots import snapshots_from_points
from edgectl.export.history_rows import RowKind, format_csv_lines
from edgectl.export.metric_samples import MetricsInput
from edgectl.export.prometheus import render_metrics_page
from edgectl.formats.kinds import PLAN_KIND
from edgectl.gateway.probe_reply import ReplyContext, decode_host_sample
from edgectl.model.inventory import Inventory
from edgectl.model.manager_state import ManagerState
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from edgectl.scheduler.assign import assign
from edgectl.scheduler.explain import explain_decision
from edgectl.state.store import Store
from edgectl.views.describe_host import HostDetailsView
from edgectl.views.explanation import ExplanationView
from edgectl.views.plan import PlanView
from edgectl.views.top_hosts import TopHostsView
from tests.builders import NOW

INVENTORY = """
version: 1
edges:
  edge3: {host: 10.0.0.3, max_temperature: 85}
  edge2: {host: 10.0.0.2, capacity: {power: 30W}, limits: {power: 80%}}
  edge1: {host: 10.0.0.1}
robots:
  robot1: {host: 10.0.1.1, onboard: true, limits: {battery: 80%}}
links:
  - {edge: edge1, robot: robot1, throughput: 54Mbit/s}
  - {edge: edge2, robot: robot1, throughput: 54Mbit/s}
  - {edge: edge3, robot: robot1, throughput: 54Mbit/s}
"""
Reading = Mapping[str, object]
REPLY = {"cpu": {"cores": 4, "used_cores": 1}, "memory": {"total_bytes": 8e9, "used_bytes": 1e9}}
CARD: Reading = {
    "gpu": {"gpus": 1.0, "used_gpus": 0.25},
    "gpu_memory": {"gpu_total_bytes": 8 * 2**30, "gpu_used_bytes": 2**30},
}
LINKS = {"robot1": {"rx_bytes_per_s": 0, "tx_bytes_per_s": 0, "interface": "eth0", "reachable": True}}


def load_files(directory: Path, demand: str, more: str = "") -> tuple[Inventory, Tasks]:
    (directory / "inventory.yaml").write_text(INVENTORY)
    text = f"version: 1\ntasks:\n  slam: {{command: slam, {more}demand: {{cpu: 1, memory: 1Gi{demand}}}}}\n"
    (directory / "tasks.yaml").write_text(text)
    found = load_inventory_and_tasks(directory / "inventory.yaml", [directory / "tasks.yaml"])
    return found[0], found[1]


def a_snapshot(inventory: Inventory, readings: Mapping[str, Reading]) -> Snapshot:
    samples = {}
    for host in (*inventory.edges, *inventory.robots):
        reply = {
            "v": 1,
            "op": "probe",
            "host": host.name,
            **REPLY,
            "links": LINKS,
            **readings.get(host.name, {}),
        }
        context = ReplyContext(host=host, answered_at=NOW, robots=("robot1",), declared={"robot1": 6.75e6})
        samples[host.name] = decode_host_sample(reply, context)
    return Snapshot(taken_at=NOW, hosts=samples, manager=ManagerState())


def a_plan(files: tuple[Inventory, Tasks], readings: Mapping[str, Reading], weights: str = "all") -> Plan:
    inventory, tasks = files
    snapshot = a_snapshot(inventory, readings)
    policy = Policy(weights=parse_weights(weights))
    assignment = assign(inventory, tasks, snapshot, ManagerState(), policy, NOW)
    return plan_from_assignment(inventory, tasks, snapshot, ManagerState(), assignment)


def get_ranking(plan: Plan) -> dict[str, tuple[bool, list[str]]]:
    ranking = plan.steps[0].decision.ranking
    return {
        each.host: (each.feasible, [f"{one.rule} {one.resource}" for one in each.rejections])
        for each in ranking
    }


def test_only_a_host_with_a_gpu_takes_a_task_that_demands_one(tmp_path: Path) -> None:
    files = load_files(tmp_path, ", gpu: 50%, gpu_memory: 4Gi")
    plan = a_plan(files, {"edge2": CARD})
    assert plan.steps[0].decision.host == "edge2"
    lacking = (False, ["no-capacity gpu", "no-capacity gpu memory"])
    assert get_ranking(plan) == {"edge1": lacking, "edge2": (True, []), "edge3": lacking}
    assert "without capacity" in PlanView(plan).wide()


def test_a_task_that_demands_none_goes_anywhere(tmp_path: Path) -> None:
    full: Reading = {"gpu": {"gpus": 1.0, "used_gpus": 1.0}}
    cases: list[dict[str, Reading]] = [{}, {"edge2": full}]
    for readings in cases:
        plan = a_plan(load_files(tmp_path, ""), readings)
        assert all(feasible for feasible, _ in get_ranking(plan).values())
        assert ("GPU" in PlanView(plan).wide()) is bool(readings), "only a fleet that has one sees it"


def test_a_gpu_without_room_is_told_in_its_units(tmp_path: Path) -> None:
    plan = a_plan(load_files(tmp_path, ", gpu: 0.8"), {"edge2": CARD})
    assert plan.steps[0].decision.host is None
    assert get_ranking(plan)["edge2"] == (False, ["insufficient gpu"])
    assert "short of gpu by 0.05 GPUs (need 0.80 GPUs, free 0.75 GPUs)" in PlanView(plan).wide()


def test_no_host_has_a_gpu(tmp_path: Path) -> None:
    files = load_files(tmp_path, ", gpu: 0.1")
    plan = a_plan(files, {})
    assert plan.steps[0].decision.host is None
    assert all(found == (False, ["no-capacity gpu"]) for found in get_ranking(plan).values())
    assert PLAN_KIND.decode(PLAN_KIND.encode(plan)) == plan


def test_the_weight_of_the_gpu(tmp_path: Path) -> None:
    """Weighed, the term is the free share; the presets do not weigh it."""
    readings: dict[str, Reading] = {"edge2": CARD, "edge1": {"gpu": {"gpus": 2.0, "used_gpus": 1.8}}}
    files = load_files(tmp_path, ", gpu: 0.1")
    plan = a_plan(files, readings, "gpu")
    terms = {each.host: each.terms["gpu"] for each in plan.steps[0].decision.ranking}
    assert terms == {"edge1": pytest.approx(0.05), "edge2": pytest.approx(0.65), "edge3": None}
    assert plan.steps[0].decision.host == "edge2"
    assert parse_weights("all")["gpu"] == 0


def test_a_power_budget(tmp_path: Path) -> None:
    files = load_files(tmp_path, ", power: 6W")
    plan = a_plan(files, {"edge2": {"power": {"used_watts": 20.0}}})
    rejected = {entry.host: entry.rejections for entry in plan.steps[0].decision.ranking}["edge2"][0]
    assert (str(rejected.resource), rejected.demand, rejected.capacity) == ("power", 6.0, 24.0)
    assert "short of power by 2.0W (need 6.0W, free 4.0W)" in PlanView(plan).wide()
    plan = a_plan(files, {"edge2": {"power": {"used_watts": 12.0}}}, "power")
    terms = {entry.host: entry.terms["power"] for entry in plan.steps[0].decision.ranking}
    assert terms == {"edge1": 1.0, "edge2": (24.0 - 12.0 - 6.0) / 24.0, "edge3": 1.0}
    inventory, tasks = files
    step = plan.steps[0]
    explained = explain_decision(inventory, tasks.tasks["slam"], plan.snapshot, step.decision, plan.policy)
    assert "power" in ExplanationView(step, explained).wide()


@pytest.mark.parametrize(
    ("celsius", "usable"), [(60.0, 4.0), (70.0, 4.0), (77.5, 2.5), (85.0, 1.0), (99.0, 1.0)]
)
def test_heat_takes_cores_away(tmp_path: Path, celsius: float, usable: float) -> None:
    plan = a_plan(load_files(tmp_path, ""), {"edge3": {"temperature_c": celsius}}, "cpu")
    terms = {entry.host: entry.terms["cpu"] for entry in plan.steps[0].decision.ranking}
    assert terms["edge3"] == pytest.approx((usable - 2.0) / usable)
    assert terms["edge1"] == pytest.approx(0.5)
    assert get_ranking(plan)["edge3"][0] is (usable >= 2.0)


def test_heat_is_told(tmp_path: Path) -> None:
    inventory, _ = load_files(tmp_path, "")
    snapshot = a_snapshot(inventory, {"edge3": {"temperature_c": 80.0}, "edge1": {"temperature_c": 99.0}})
    told = "edge3 is at 80C of 85C: 50% of its cores and GPU are usable"
    assert TopHostsView(snapshot, inventory, ()).warnings() == [told]
    text = HostDetailsView("edge3", snapshot, inventory, Tasks(tasks={}), None).table()
    assert "max 85C" in text


def test_a_low_battery_keeps_tasks_off_the_robot(tmp_path: Path) -> None:
    """Of 80 % of the charge a task may use all; below the rest, nothing is placed onboard."""
    files = load_files(tmp_path, "", "robot: robot1, ")
    for used, feasible in ((0.3, True), (0.85, False)):
        battery = {"battery": {"full_charge": 1.0, "used_charge": used}}
        plan = a_plan(files, {"robot1": battery}, "battery")
        assert get_ranking(plan)["robot1"] == (feasible, [] if feasible else ["insufficient battery"])
        assert plan.steps[0].decision.host == "edge1"


def test_a_full_battery_weighs_nothing_against_onboard(tmp_path: Path) -> None:
    files = load_files(tmp_path, "", "robot: robot1, ")
    plan = a_plan(files, {"robot1": {"battery": {"full_charge": 1.0, "used_charge": 0.0}}}, "battery")
    terms = {entry.host: entry.terms["battery"] for entry in plan.steps[0].decision.ranking}
    assert set(terms.values()) == {1.0}


def test_history_exports_and_metrics_have_them(tmp_path: Path) -> None:
    inventory, _ = load_files(tmp_path, "")
    readings: dict[str, Reading] = {
        "edge2": {**CARD, "power": {"used_watts": 12.5}},
        "edge1": {"power": {"used_watts": 5.0}},
    }
    snapshot = a_snapshot(inventory, readings)
    assert snapshot.hosts["edge1"].device.power_w == 5.0
    assert "power" not in snapshot.hosts["edge1"].usage, "without a budget it is shown and limits nothing"
    with Store.open(tmp_path) as store:
        store.record_snapshot(snapshot)
        points = store.host_points()
    again = snapshots_from_points(inventory, points, (), ())[0]
    assert again.hosts["edge2"].usage == snapshot.hosts["edge2"].usage
    header = next(iter(format_csv_lines(RowKind.HOSTS, points)))
    names = "gpus,used_gpus,gpu_total_bytes,gpu_used_bytes,budget_watts,used_watts,full_charge,used_charge"
    assert header.strip().endswith(names)
    plan = a_plan((inventory, Tasks(tasks={})), readings)
    page = render_metrics_page(MetricsInput(version="1", snapshot=snapshot, plan=plan))
    for line in (
        'power_used_watts{host="edge2"} 12.5',
        'gpu_used_gpus{host="edge2"} 0.25',
        'gpu_memory_bytes{host="edge2"}',
    ):
        assert f"edgectl_host_{line}" in page
    assert 'edgectl_host_draw_watts{host="edge1"} 5' in page


def test_a_slice_has_what_it_declares(tmp_path: Path) -> None:
    """Its machine's GPU is not its own."""
    inventory, _ = load_files(tmp_path, "")
    host = inventory.hosts["edge1"]
    own = replace(host, capacity=type(inventory.hosts["edge2"].capacity)(cpu=2.0, memory=2e9))  # type: ignore[misc]
    reply = {"v": 1, "op": "probe", "host": "edge1", **REPLY, **CARD}
    assert "gpu" not in decode_host_sample(reply, ReplyContext(host=own, answered_at=NOW)).usage


@pytest.mark.parametrize(
    ("wrong", "hint"),
    [
        (", gpu_memory: 50%", "write bytes as 90Mi"),
        (", gpu: many", "write shares of a GPU as 50% or 0.5"),
        (", power: 6 volts", "write watts as 15W"),
        (", battery: full", "write shares of a full battery"),
    ],
)
def test_a_wrong_demand_says_how_to_write_it(tmp_path: Path, wrong: str, hint: str) -> None:
    with pytest.raises(InputError) as raised:
        load_files(tmp_path, wrong)
    assert hint in str([problem.hint for problem in raised.value.problems])


@pytest.mark.parametrize("readings", [{}, {"edge2": CARD}], ids=["no card", "a card"])
@pytest.mark.parametrize("demand", ["", ", gpu: 50%, gpu_memory: 4Gi", ", power: 5W"])
def test_the_scan_of_large_fleets_decides_the_same(
    demand: str, readings: Mapping[str, Reading], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("numpy")
    files = load_files(tmp_path, demand)
    plain = a_plan(files, readings)
    monkeypatch.setattr("edgectl.scheduler.assign.MIN_ARRAY_PAIRS", 0)
    found = a_plan(files, readings)
    assert [step.decision for step in found.steps] == [step.decision for step in plain.steps]
