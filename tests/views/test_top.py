# SPDX-License-Identifier: Apache-2.0
"""top: golden texts at 80 and 160 columns, in ASCII and piped; figures worked by hand."""

import json
from dataclasses import replace

import yaml

from edgectl.model.check import Check
from edgectl.model.demand import Demand, Quantity
from edgectl.model.latency import LatencySample
from edgectl.model.manager_state import ManagerState, MeasuredDemand
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.resource import Usage
from edgectl.model.snapshot import DeviceSample, HostStatus, InterfaceSample, Snapshot, TaskState
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.text import RenderOptions
from edgectl.views.top_hosts import TopHostsView
from edgectl.views.top_tasks import TopTasksView
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
    silent,
    some_tasks,
)
from tests.views.fixtures import show

FLEET = an_inventory(an_edge("edge1", cpu_limit=0.8), an_edge("edge2"), a_robot("robot1"))
TASKS = some_tasks(
    a_task("detection", cpu=2.0, memory=GI, throughput=2e6, robots=["robot1"], ready=Check(command="true")),
    a_task("slam", cpu="25%", memory=None, throughput=None, robots=["robot1"]),
    a_task("idle"),
)

RUNS = {
    "detection": a_run(started_at=NOW - 252, used=Usage(cpu=2.5, memory=0.75 * GI, network=2e6)),
    "slam": a_run(TaskState.RUNNING, started_at=NOW - 3780, used=Usage(cpu=0.9, memory=GI / 2, network=5e5)),
    "stray": a_run(TaskState.STARTING, used=Usage(cpu=0.1)),
    "dead": a_run(TaskState.FAILED, used=Usage(cpu=9.0)),
}


def snapshot() -> Snapshot:
    edge1 = a_sample(
        used=3.9, used_memory=GI, tasks=RUNS, links={"robot1": a_link(10e6, 4e6), "robot2": a_link(10e6, 1e6)}
    )
    device = DeviceSample(
        load_1m=3.5,
        temperature_c=61.4,
        interfaces={"eth0": InterfaceSample(rx_bytes_per_s=1e6, tx_bytes_per_s=2e6)},
    )
    return a_snapshot(
        edge1=replace(edge1, device=device),
        edge2=silent(),
        robot1=a_sample(cores=2.0),
        memory=ManagerState(cordons=frozenset({"robot1"})),
    )


def host_points() -> tuple[HostPoint, ...]:
    """Edge1 rose from 0 to 3.5 of 4 cores in eight samples and did not answer before the last one."""
    used = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, None, 4.0]
    return tuple(
        HostPoint(
            at=NOW + n,
            host="edge1",
            status=HostStatus.OK,
            usage={} if cores is None else a_sample(used=cores).usage,
        )
        for n, cores in enumerate(used)
    )


def task_points() -> tuple[TaskPoint, ...]:
    """Detection used 1, 2 and 4 cores; its demand is 2."""
    return tuple(
        TaskPoint(
            at=NOW + n,
            task="detection",
            host="edge1",
            state=TaskState.READY,
            used=Usage(cpu=cores, memory=GI),
        )
        for n, cores in enumerate((1.0, 2.0, 4.0))
    )


def hosts_view() -> TopHostsView:
    return TopHostsView(snapshot(), FLEET, host_points())


def tasks_view(value: Snapshot | None = None) -> TopTasksView:
    return TopTasksView(value or snapshot(), FLEET, TASKS, task_points())


def hosts(form: OutputFormat = OutputFormat.TABLE, look: RenderOptions | None = None) -> str:
    return show(hosts_view(), form, look or RenderOptions())


def tasks(
    form: OutputFormat = OutputFormat.TABLE, look: RenderOptions | None = None, value: Snapshot | None = None
) -> str:
    return show(tasks_view(value), form, look or RenderOptions())


NOTES = "note: edge1 uses 98% of its cpu; its limit is 80%\nnote: edge2 does not answer: connection refused\n"


def test_hosts_piped() -> None:
    assert hosts() == (
        "HOST    STATUS        CPU%  MEMORY%  LINK        TASKS\n"
        "edge1   ok            98%!      25%  40% robot1      3\n"
        "edge2   unreachable      -        -  -               -\n"
        "robot1  ok, cordoned    0%       0%  -               0\n" + NOTES
    )


HEAD = "HOST    STATUS                  CPU%        MEMORY%  LINK        TASKS"
EDGE1 = "edge1   ok            ███████▊  98%!  ██        25%  40% robot1      3"
REST = [
    "edge2   unreachable                -              -  -               -",
    "robot1  ok, cordoned              0%             0%  -               0",
]


def test_hosts_on_a_wide_terminal() -> None:
    lines = hosts(look=RenderOptions(width=160, unicode=True)).splitlines()
    assert lines[:4] == [HEAD + "  CPU, LAST 10 SAMPLES", EDGE1 + "            ▁▂▃▄▅▆▇█ █", *REST]


def test_hosts_on_a_narrow_terminal() -> None:
    lines = hosts(look=RenderOptions(width=80, unicode=True)).splitlines()
    assert lines[:6] == [HEAD, "    CPU, LAST 10 SAMPLES", EDGE1, "    ▁▂▃▄▅▆▇█ █", *REST]


def test_hosts_in_ascii() -> None:
    text = hosts(look=RenderOptions(width=160))
    assert (
        "edge1   ok            #######.  98%!  ##......  25%  40% robot1      3            _.-:=+*# #\n"
        in text
    ), "98 % of 8 is 7.8, but not all"
    assert text.isascii()


def test_sixty_samples_stand_below_where_there_is_no_room_beside() -> None:
    points = tuple(
        HostPoint(
            at=NOW + n, host="edge1", status=HostStatus.OK, usage=a_sample(used=4.0 if n % 2 else 0.0).usage
        )
        for n in range(100)
    )
    lines = render_view(
        TopHostsView(snapshot(), FLEET, points), OutputFormat.TABLE, RenderOptions(width=80, unicode=True)
    ).splitlines()
    assert lines[1] == "    CPU, LAST 60 SAMPLES"
    assert lines[2].startswith("edge1 ")
    assert lines[3] == "    " + "▁█" * 30
    wide = render_view(
        TopHostsView(snapshot(), FLEET, points), OutputFormat.TABLE, RenderOptions(width=160, unicode=True)
    ).splitlines()
    assert wide[0].endswith("CPU, LAST 60 SAMPLES")
    assert wide[1].endswith("3  " + "▁█" * 30)


def test_wide_hosts_say_absolute_numbers() -> None:
    assert hosts(OutputFormat.WIDE).splitlines()[1].split()[-7:] == [
        "0.0s",
        "3.90/4.00",
        "1.0Gi/4.0Gi",
        "1.0MB/s",
        "2.0MB/s",
        "3.50",
        "61C",
    ]


TABLE = (
    "TASK       HOST    CPU  CPU DEMAND  CPU EXCESS   MEMORY    NETWORK    AGE  READY\n"
    "detection  edge1  2.50        2.00       +0.50  768.0Mi    2.0MB/s  4m12s  yes\n"
    "slam       edge1  0.90        1.00       -100m  512.0Mi  500.0kB/s  1h03m  -\n"
    "stray      edge1  0.10           -           -       0B       0B/s  1h00m  no\n"
)
TASK_NOTES = (
    "note: 1 of 3 tasks do not run: edgectl status\nnote: edge2 does not answer: connection refused\n"
)


def test_tasks_piped() -> None:
    assert tasks() == TABLE + TASK_NOTES


METRICS = {f"m{number}": number / 3 for number in range(12)}


def saying() -> Snapshot:
    runs = {
        **RUNS,
        "slam": replace(RUNS["slam"], metrics={"fps": 29.97, "loss": 1.5e-7}),
        "stray": replace(RUNS["stray"], metrics=METRICS),
    }
    runs["dead"] = replace(RUNS["dead"], metrics={"fps": 1.0})
    return replace(
        snapshot(), hosts={**snapshot().hosts, "edge1": replace(snapshot().hosts["edge1"], tasks=runs)}
    )


def test_latencies_stand_below_without_a_deadline_without_misses() -> None:
    late = LatencySample(
        count=2400, misses=31, bound_ms=100.0, recent_count=1200, recent_misses=4, p50_ms=20.4, p95_ms=61.0, p99_ms=123.4, max_ms=180.0, recent_s=92.0,
    )  # fmt: skip
    runs = {
        "slam": replace(RUNS["slam"], latency=late),
        "detection": replace(RUNS["detection"], latency=LatencySample(error="no rclpy")),
        "dead": replace(RUNS["dead"], latency=late),
    }
    edge1 = replace(snapshot().hosts["edge1"], tasks=runs)
    shown = tasks(value=replace(snapshot(), hosts={**snapshot().hosts, "edge1": edge1}))
    assert (
        "\nTASK       HOST       P50    P95     P99     MAX  DEADLINE  RECENT MISSES  MISSES  VALUES\n"
        "detection  edge1        -      -       -       -         -              -       -       0\n"
        "slam       edge1  20.4 ms  61 ms  123 ms  180 ms    100 ms              4      31    2400\n"
    ) in shown
    assert "latency of detection is not known: no rclpy" in shown


def test_what_applications_say_of_themselves_stands_below() -> None:
    said = ", ".join(f"{name} {value:.6g}" for name, value in METRICS.items())
    below = f"\nTASK   HOST   METRICS\nslam   edge1  fps 29.97, loss 1.5e-07\nstray  edge1  {said}\n"
    assert tasks(value=saying()) == TABLE + below + TASK_NOTES
    narrow = tasks(value=saying(), look=RenderOptions(width=80))
    assert max(map(len, narrow.splitlines())) <= 80
    assert (
        "stray  edge1  m0 0, m1 0.333333, m2 0.666667, m3 1, m4 1.33333, m5 1.66667, m6\n              2, m7 2.33333,"
        in narrow
    )
    found = {
        task["task"]: task.get("metrics")
        for task in json.loads(tasks(OutputFormat.JSON, value=saying()))["items"]
    }
    rounded = {name: float(f"{value:.6g}") for name, value in METRICS.items()}
    assert found == {"detection": None, "slam": {"fps": 29.97, "loss": 1.5e-7}, "stray": rounded}


def test_tasks_on_a_terminal() -> None:
    lines = tasks(look=RenderOptions(width=160, unicode=True)).splitlines()
    assert lines[0] == TABLE.splitlines()[0] + "  CPU, LAST 3 SAMPLES"
    assert lines[1] == TABLE.splitlines()[1] + "    ▃▅█", "of the highest, 4 cores: a quarter, a half, all"
    assert lines[2] == TABLE.splitlines()[2]
    narrow = tasks(look=RenderOptions(width=80, unicode=True)).splitlines()
    assert narrow[:3] == [
        "TASK       HOST    CPU      CPU       CPU   MEMORY    NETWORK    AGE  READY",
        "                         DEMAND    EXCESS",
        "detection  edge1  2.50     2.00     +0.50  768.0Mi    2.0MB/s  4m12s  yes    ▃▅█",
    ]
    assert max(map(len, narrow)) <= 80


def test_more_than_demanded_is_marked_without_colour_too() -> None:
    assert "\x1b[33m+0.50\x1b[0m" in tasks(look=RenderOptions(colour=True))
    assert "\x1b[33m-100m" not in tasks(look=RenderOptions(colour=True))


def test_wide_tasks_say_every_demand() -> None:
    assert tasks(OutputFormat.WIDE).splitlines()[1].split()[9:] == [
        "1.0Gi",
        "-256.0Mi",
        "2.0MB/s",
        "0B/s",
        "0",
    ]
    assert tasks(OutputFormat.WIDE).splitlines()[2].split()[9:] == ["-", "-", "-", "-", "0"]


def test_a_measured_demand_counts_where_it_was_asked_for() -> None:
    measured = replace(
        TASKS.tasks["slam"],
        demand=Demand({**TASKS.tasks["slam"].demand, "cpu": Quantity(value=1.0, measured=True)}),
    )
    found = MeasuredDemand(samples=400, span_s=4000.0, used={"cpu": 0.75, "memory": GI})
    value = replace(
        snapshot(), manager=ManagerState(measured={("slam", "4c-4Gi"): found, ("detection", "4c-4Gi"): found})
    )
    rows = render_view(
        TopTasksView(value, FLEET, some_tasks(measured, TASKS.tasks["detection"]), ()), OutputFormat.WIDE
    ).splitlines()
    assert rows[2].split()[2:5] == ["0.90", "0.75", "+0.15"]
    assert rows[2].split()[9:11] == ["1.0Gi", "-512.0Mi"], "left out is measured too"
    assert rows[1].split()[3] == "2.00", "declared stays declared"


def test_nothing_runs() -> None:
    assert (
        show(TopTasksView(a_snapshot(edge1=a_sample()), FLEET, TASKS, ()))
        == "note: 3 of 3 tasks do not run: edgectl status\n"
    )


def test_documents() -> None:
    document = json.loads(hosts(OutputFormat.JSON))
    assert (document["format_version"], document["kind"]) == (2, "host-usage")
    assert [host["host"] for host in document["items"]] == ["edge1", "edge2", "robot1"]
    assert document["items"][0]["history"][-2:] == [
        {"at": "2025-11-21T01:53:28Z"},
        {"at": "2025-11-21T01:53:29Z", "used_cores": 4, "memory_used_bytes": 0},
    ]
    assert [f"note: {line}" for line in document["warnings"]] == NOTES.splitlines()
    assert yaml.safe_load(hosts(OutputFormat.YAML)) == document
    document = json.loads(tasks(OutputFormat.JSON))
    assert [task["task"] for task in document["items"]] == ["detection", "slam", "stray"]
    first = document["items"][0]
    assert (first["cpu"], first["memory"], first["network"]) == (
        {"used_cores": 2.5, "demand_cores": 2, "excess_cores": 0.5},
        {"used_bytes": 0.75 * GI, "demand_bytes": GI, "excess_bytes": -0.25 * GI},
        {"used_bytes_per_s": 2e6, "demand_bytes_per_s": 2e6, "excess_bytes_per_s": 0},
    )
    assert document["items"][2]["cpu"].keys() == {"used_cores"}
    assert yaml.safe_load(tasks(OutputFormat.YAML)) == document
    lines = [json.loads(line) for line in tasks(OutputFormat.JSONL).splitlines()]
    assert lines == document["items"]
