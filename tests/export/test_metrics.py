# SPDX-License-Identifier: Apache-2.0
"""The metrics page as read by Prometheus' own tools."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from edgectl.export.metric_samples import BUCKETS_S, TASK_STATES, MetricsInput
from edgectl.export.metrics import METRICS, MetricType
from edgectl.export.prometheus import render_metrics_page
from edgectl.model.plan import Action
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.snapshot import TaskState
from tests.builders import NOW
from tests.docs.metrics import PAGE
from tests.docs.metrics import page as listed
from tests.export.metrics_inputs import a_metrics_input, a_move, a_revision
from tests.pace import patience

LABELS = {
    "host",
    "role",
    "edge",
    "robot",
    "task",
    "state",
    "action",
    "outcome",
    "version",
    "name",
    "percentile",
}


def parse_page(seen: MetricsInput) -> dict[str, float]:
    """Return ``name{label values}`` -> value, as prometheus_client's parser reads the page."""
    found = {}
    for family in text_string_to_metric_families(render_metrics_page(seen)):
        for sample in family.samples:
            labels = ",".join(f"{key}={value}" for key, value in sample.labels.items())
            found[sample.name + (f"{{{labels}}}" if labels else "")] = sample.value
    return found


@pytest.fixture(scope="module")
def page() -> dict[str, float]:
    return parse_page(
        a_metrics_input(
            a_revision(1, a_move()),
            a_revision(2, a_move(downtime_s=3.0), a_move(outcome=Outcome.FAILED, downtime_s=None)),
        )
    )


def test_hosts_and_links(page: dict[str, float]) -> None:
    assert page["edgectl_build_info{version=1.2.3}"] == 1.0
    assert page["edgectl_last_probe_timestamp_seconds"] == NOW
    assert page["edgectl_host_up{host=edge1,role=edge}"] == 1.0
    assert page["edgectl_host_up{host=edge2,role=edge}"] == 0.0
    assert page["edgectl_host_cordoned{host=edge1}"] == 1.0
    assert page["edgectl_host_cordoned{host=edge2}"] == 0.0
    assert page["edgectl_host_last_contact_timestamp_seconds{host=edge2}"] == NOW - 60.0
    assert page["edgectl_host_cpu_cores{host=edge1}"] == 4.0
    assert page["edgectl_host_cpu_used_cores{host=edge1}"] == 0.9
    assert page["edgectl_host_memory_bytes{host=edge1}"] == 4 * 2**30
    assert page["edgectl_host_memory_used_bytes{host=edge1}"] == 5e8
    assert page["edgectl_host_network_receive_bytes_per_second{host=edge1}"] == 120.0, "all interfaces but lo"
    assert page["edgectl_host_network_transmit_bytes_per_second{host=edge1}"] == 12.0
    assert page["edgectl_host_gpu_used_ratio{host=edge1}"] == 0.25
    assert page["edgectl_link_capacity_bytes_per_second{edge=edge1,robot=robot1}"] == 6e6
    assert page["edgectl_link_used_bytes_per_second{edge=edge1,robot=robot1}"] == 3e5
    assert page["edgectl_link_round_trip_seconds{edge=edge1,robot=robot1}"] == 0.004


def test_a_silent_host_has_no_readings(page: dict[str, float]) -> None:
    readings = [name for name in page if "host=edge2" in name and "up{" not in name]
    assert readings == [
        "edgectl_host_cordoned{host=edge2}", "edgectl_host_fenced{host=edge2}", "edgectl_host_last_contact_timestamp_seconds{host=edge2}",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("task", "state"),
    [("slam", "ready"), ("map", "unknown"), ("camera", "stopped"), ("big", "stopped"), ("job", "completed")],
)
def test_a_task_is_in_one_state(page: dict[str, float], task: str, state: str) -> None:
    assert {each: page[f"edgectl_task_state{{state={each},task={task}}}"] for each in TASK_STATES} == {
        each: each == state for each in TASK_STATES
    }


def test_runs_and_decisions(page: dict[str, float]) -> None:
    assert page["edgectl_task_host_info{host=edge1,task=slam}"] == 1.0
    assert page["edgectl_task_start_timestamp_seconds{host=edge1,task=slam}"] == NOW - 3600.0
    assert page["edgectl_task_restarts_total{host=edge1,task=slam}"] == 2.0
    assert page["edgectl_task_cpu_used_cores{host=edge1,task=slam}"] == 0.8
    assert page["edgectl_task_memory_used_bytes{host=edge1,task=slam}"] == 2e8
    assert page["edgectl_task_network_used_bytes_per_second{host=edge1,task=slam}"] == 3e5
    assert page["edgectl_task_app_metric{host=edge1,name=fps,task=slam}"] == 29.5
    assert page["edgectl_task_app_metric{host=edge1,name=map/loss:train.1,task=slam}"] == -1e300

    assert not [name for name in page if "name=done" in name], "a job that is over says nothing any more"
    assert page["edgectl_task_unplaced{task=big}"] == page["edgectl_task_unplaced{task=camera}"] == 1.0
    assert page["edgectl_task_unplaced{task=slam}"] == 0.0
    assert page["edgectl_plan_actions{action=unplaced}"] == 2.0
    assert page["edgectl_plan_actions{action=start}"] == 0.0
    assert page["edgectl_plan_settled"] == 1.0
    pinned = {name: value for name, value in page.items() if name.startswith("edgectl_task_pinned")}
    assert pinned == {"edgectl_task_pinned{host=edge3,task=camera}": 0.0}, "its file keeps it off edge3"


def test_latency_is_a_histogram_of_all_values_and_percentiles_of_the_recent(page: dict[str, float]) -> None:
    counts = {
        bound: page[f"edgectl_task_latency_seconds_bucket{{host=edge1,le={bound},task=slam}}"]
        for bound in ("0.005", "0.01", "0.02", "0.05", "0.1", "0.2", "+Inf")
    }
    assert list(counts.values()) == [0, 1, 1, 2, 2, 3, 3]
    assert page["edgectl_task_latency_seconds_sum{host=edge1,task=slam}"] == 0.26
    assert page["edgectl_task_latency_recent_seconds{host=edge1,percentile=95,task=slam}"] == 0.2
    assert page["edgectl_task_latency_misses_total{host=edge1,task=slam}"] == 1.0


def test_totals_are_those_of_the_plan() -> None:
    seen = a_metrics_input()
    page = parse_page(seen)
    decided = [step.decision for step in seen.plan.steps]
    totals = {each.task: each.total for each in decided if each.total is not None}
    assert totals
    assert {name: value for name, value in page.items() if name.startswith("edgectl_task_utility{")} == {
        f"edgectl_task_utility{{task={task}}}": total for task, total in totals.items()
    }


def test_handoffs_of_the_past(page: dict[str, float]) -> None:
    assert page["edgectl_actions_total{action=move,outcome=done}"] == 2.0
    assert page["edgectl_actions_total{action=move,outcome=failed}"] == 1.0
    assert page["edgectl_actions_total{action=start,outcome=done}"] == 0.0
    assert page["edgectl_task_moves_total{task=slam}"] == 2.0
    assert page["edgectl_task_moves_total{task=map}"] == 0.0
    assert page["edgectl_handoff_downtime_seconds_count{action=move}"] == 2.0
    assert page["edgectl_handoff_downtime_seconds_sum{action=move}"] == pytest.approx(3.7)
    buckets = [
        page[f"edgectl_handoff_downtime_seconds_bucket{{action=move,le={bound}}}"]
        for bound in (*BUCKETS_S, "+Inf")
    ]
    assert buckets == [sum(value <= bound for value in (0.7, 3.0)) for bound in (*BUCKETS_S, float("inf"))]
    assert page["edgectl_last_change_timestamp_seconds"] == NOW + 7200.0


def test_a_task_that_left_the_files_leaves_the_metrics() -> None:
    page = parse_page(a_metrics_input(a_revision(1, a_move("gone"))))
    assert not [name for name in page if "task=gone" in name]
    assert page["edgectl_actions_total{action=move,outcome=done}"] == 1.0


def test_before_the_first_change_counters_stand_at_zero() -> None:
    page = parse_page(a_metrics_input())
    assert page["edgectl_task_moves_total{task=slam}"] == 0.0
    assert page["edgectl_handoff_downtime_seconds_count{action=move}"] == 0.0
    assert "edgectl_last_change_timestamp_seconds" not in page


def yield_growing_inputs() -> Iterator[MetricsInput]:
    """Yield the same fleet over four applies."""
    actions: list[ActionResult] = [
        a_move(),
        a_move(downtime_s=200.0),
        a_move(outcome=Outcome.DEFERRED, downtime_s=None),
        a_move("map"),
    ]
    for count in range(len(actions) + 1):
        yield a_metrics_input(
            *(a_revision(number, action) for number, action in enumerate(actions[:count], 1))
        )


def test_counters_never_fall() -> None:
    counted = tuple(m.name for m in METRICS if m.kind is not MetricType.GAUGE)
    pages = [
        {name: value for name, value in parse_page(each).items() if name.startswith(counted)}
        for each in yield_growing_inputs()
    ]
    for before, after in pairwise(pages):
        assert before.keys() == after.keys()
        assert all(after[name] >= value for name, value in before.items())
    assert pages[-1] != pages[0]


def test_names_and_labels_keep_to_the_conventions() -> None:
    assert len({metric.name for metric in METRICS}) == len(METRICS)
    for metric in METRICS:
        assert re.fullmatch(r"edgectl_[a-z]+(_[a-z]+)*", metric.name)
        assert set(metric.labels) <= LABELS
        assert metric.help.endswith(".")
        assert metric.name.endswith("_total") == (metric.kind is MetricType.COUNTER)
    assert {state.value for state in TaskState} < set(TASK_STATES)
    assert len(Action) == 11


def run_promtool(*words: str, page: str = "") -> tuple[int, str]:
    """Run promtool; return its output."""
    beside = Path(sys.executable).parent
    program = shutil.which("promtool", path=f"{os.environ.get('PATH', os.defpath)}{os.pathsep}{beside}")
    assert program, "promtool is missing; run .ci/need-promtool"
    done = subprocess.run(
        [program, *words],
        input=page,
        capture_output=True,
        text=True,
        check=False,
        timeout=patience(60),
    )
    return done.returncode, done.stdout + done.stderr


def test_promtool_finds_nothing_to_say() -> None:
    page = render_metrics_page(a_metrics_input(a_revision(1, a_move())))
    assert run_promtool("check", "metrics", page=page) == (0, "")


def test_promtool_would_say_what_is_wrong() -> None:
    page = render_metrics_page(a_metrics_input()).replace("edgectl_actions_total", "edgectl_actions")
    code, said = run_promtool("check", "metrics", page=page)
    assert code != 0
    assert "edgectl_actions counter metrics should have" in said


def test_every_metric_is_on_the_page() -> None:
    seen = a_metrics_input(a_revision(1, a_move()))
    budgets = {f"edgectl_host_{resource.name}" for resource in HOST_RESOURCES if resource.optional}
    empty = [metric.name for metric in METRICS if not metric.samples(seen)]
    assert [name for name in empty if not name.startswith(tuple(budgets))] == []
    kinds = dict(re.findall(r"^# TYPE (\S+) (\S+)$", render_metrics_page(seen), re.MULTILINE))
    assert kinds == {metric.name: metric.kind.value for metric in METRICS}


def test_there_are_no_more_series_than_the_page_of_the_docs_says() -> None:
    seen = a_metrics_input(a_revision(1, a_move()))
    lines = [line for line in render_metrics_page(seen).splitlines() if not line.startswith("#")]
    hosts, links, tasks, runs, said_of_themselves = len(seen.snapshot.hosts), 2, len(seen.plan.steps), 1, 2
    said = PAGE.read_text()
    assert re.search(
        r"at most 14 series\s+per host, 3 per link, 12 per task \(13 if it is pinned\) and 6 more for each host on which it runs, and 60 others",
        said,
    )
    assert "19 where a latency is measured" in said
    assert (
        len(lines) <= 14 * hosts + 3 * links + 12 * tasks + (6 + 19) * runs + 60 + said_of_themselves + 2
    )  # pins


def test_the_list_of_the_docs_is_current() -> None:
    assert PAGE.read_text() == listed(), "run: python -m tests.docs.metrics"
