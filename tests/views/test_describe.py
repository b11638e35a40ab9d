# SPDX-License-Identifier: Apache-2.0
"""describe: golden texts at 80 and 160 columns; secrets hidden; control characters escaped."""

import json
from dataclasses import replace

import pytest
import yaml

from edgectl.model.check import Check, CheckLocation
from edgectl.model.demand import Demand, Quantity
from edgectl.model.event import Event, EventKind
from edgectl.model.image import ContainerImage
from edgectl.model.inventory import Capacity
from edgectl.model.manager_state import ManagerState, Placement
from edgectl.model.resource import Usage
from edgectl.model.secret import Secret
from edgectl.model.snapshot import (
    CapacitySource,
    DeviceSample,
    HostSample,
    InterfaceSample,
    LinkSample,
    OtherTask,
    Snapshot,
    TaskState,
)
from edgectl.model.standby import StateRule
from edgectl.model.task import HandoffContract, Need, NeedCondition
from edgectl.views.describe_host import HostDetailsView
from edgectl.views.describe_task import TaskDetailsView
from edgectl.views.output import render_view
from edgectl.views.output_format import OutputFormat
from edgectl.views.text import RenderOptions
from tests.builders import (
    GI,
    NOW,
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
from tests.views.fixtures import plan

FLEET = an_inventory(
    an_edge("edge1", cpu_limit=0.8, labels={"gpu": "maxwell"}, port=2222, user="jetson", prelude="source /opt/ros/noetic/setup.bash",
            env={"ROS_DOMAIN_ID": "7", "TOKEN": Secret("canary-host")}),
    an_edge("edge2", capacity=Capacity(cpu=2.0, memory=GI)), a_robot("robot1", onboard=True), a_robot("robot2", probe=False),
)  # fmt: skip
SLAM = a_task(
    "slam-robot1", template="slam", robots=["robot1"], needs=[Need(task="pose", until=NeedCondition.RUNNING)], pin="edge1", priority=2.0,
    command="roslaunch edge_robot slam.launch robot:=robot1 with:=a-rather-long-line-of-arguments and:=more",
    env={"API_KEY": Secret("canary-task"), "MODE": "fast"}, demand=Demand(cpu=Quantity(value=0.5, relative=True), memory=Quantity(value=GI)),
    ready=Check(command="rosnode info /slam"),
    handoff=HandoffContract(safe_when=Check(command="at-rest", on=CheckLocation.ROBOT, timeout=5.0)),
    self_fence=60.0, state=StateRule(save=Check(command="map save"), load=Check(command="map load")),
)  # fmt: skip
TASKS = some_tasks(SLAM, a_task("idle", state=StateRule(topic="/map")))
LINK = LinkSample(
    capacity_bytes_per_s=10e6,
    used_bytes_per_s=4e6,
    rtt_ms=2.25,
    capacity_source=CapacitySource.TCP,
    capacity_age_s=3.0,
    nominal=20e6,
)
RUN = a_run(
    started_at=NOW - 252,
    used=Usage(cpu=2.5, memory=0.5 * GI, network=2e6),
    restarts=1,
    last_exit=3,
    generation=7,
)
MEMORY = ManagerState(
    contact={"edge1": NOW - 1.5}, cordons=frozenset({"edge1"}), placements={"slam-robot1": Placement(host="edge1", since=NOW - 260)},
    downtimes={("slam-robot1", "edge1"): (0.75, 1.25), ("slam-robot1", "edge2"): (2.0,), ("idle", "edge1"): (9.0,)},
)  # fmt: skip
THEIRS = OtherTask(
    fleet="hall", host="edge1", task="web", state=TaskState.RUNNING, started_by="paula@laptop", age_s=7200.0,
    instance="theirs", spec_hash="s", generation=3,
)  # fmt: skip
EVENTS = (
    Event(
        id=3, at=NOW - 260, kind=EventKind.TASK_STARTED, host="edge1", task="slam-robot1", message="took 0.7s"
    ),
    Event(
        id=4,
        at=NOW - 200,
        kind=EventKind.TASK_RESTARTED,
        host="edge1",
        task="slam-robot1",
        message="exit code 3\x1b[2J",
    ),
)


def edge1() -> HostSample:
    device = DeviceSample(
        load_1m=3.5,
        temperature_c=61.4,
        interfaces={"eth0": InterfaceSample(rx_bytes_per_s=1e6, tx_bytes_per_s=2e6)},
    )
    return replace(
        a_sample(used=3.6, used_memory=GI, tasks={"slam-robot1": RUN}, links={"robot1": LINK}),
        device=device,
        other_tasks=(OtherTask(fleet="lab", host="old1", task="slam-robot2", state=TaskState.READY),),
        foreign_tasks=(THEIRS,),
    )


def snapshot(**hosts: HostSample) -> Snapshot:
    return a_snapshot({"edge1": edge1(), "edge2": silent(), "robot1": a_sample(), **hosts}, memory=MEMORY)


def host_view(name: str) -> HostDetailsView:
    return HostDetailsView(name, snapshot(), FLEET, TASKS, EVENTS)


def task_view(name: str = "slam-robot1", value: Snapshot | None = None) -> TaskDetailsView:
    step = next(step for step in plan().steps if step.task == "slam-robot1")
    return TaskDetailsView(name, value or snapshot(), FLEET, TASKS, step, EVENTS)


def host(name: str, form: OutputFormat = OutputFormat.TABLE, look: RenderOptions | None = None) -> str:
    return render_view(host_view(name), form, look or RenderOptions())


def task(
    name: str = "slam-robot1",
    form: OutputFormat = OutputFormat.TABLE,
    look: RenderOptions | None = None,
    value: Snapshot | None = None,
) -> str:
    return render_view(task_view(name, value), form, look or RenderOptions())


HAPPENED = """\
Events:
  AT                    KIND            SUBJECT               MESSAGE
  2025-11-21T01:49:00Z  task-started    slam-robot1 on edge1  took 0.7s
  2025-11-21T01:50:00Z  task-restarted  slam-robot1 on edge1  exit code 3\\x1b[2J
"""
EDGE1 = (
    """\
Name:          edge1
Role:          edge
Address:       edge1.lab
Connection:    ssh, port 2222, user jetson
Status:        ok, cordoned
Sample age:    0.0s
Last contact:  1.5s ago
Labels:        gpu=maxwell
Capacity:      4.00 cores, 4.0Gi (measured)
Limits:        cpu 80%, memory 100%
Runtime:       auto
Prelude:       source /opt/ros/noetic/setup.bash
Environment:   ROS_DOMAIN_ID=7, TOKEN=***
Device:        load 3.50, temperature 61C
Usage:
  cpu     90%!  3.60 of 4.00 cores
  memory  25%   1.0Gi of 4.0Gi
  robot1  40%   4.0MB/s of 10.0MB/s
Links:
  ROBOT   CAPACITY  SOURCE   AGE   NOMINAL  NETWORK    RTT
  robot1  10.0MB/s  tcp     3.0s  20.0MB/s  4.0MB/s  2.2ms
Tasks:
  TASK          CPU  CPU DEMAND  CPU EXCESS   MEMORY  NETWORK    AGE  READY
  slam-robot1  2.50        2.00       +0.50  512.0Mi  2.0MB/s  4m12s  yes
Other tasks on this machine:
  FLEET  STARTED BY    HOST   TASK         STATE      AGE
  lab    -             old1   slam-robot2  ready     0.0s
  hall   paula@laptop  edge1  web          running  2h00m
Interfaces:
  INTERFACE  RECEIVED     SENT  SPEED
  eth0        1.0MB/s  2.0MB/s      -
"""
    + HAPPENED
)
SLAM_TEXT = (
    """\
Name:         slam-robot1
Template:     slam
Kind:         service
Command:      roslaunch edge_robot slam.launch robot:=robot1 with:=a-rather-long-line-of-arguments and:=more
Robots:       robot1
Needs:        pose (running)
Priority:     2
Hosts:        pin edge1; onboard allow
Ready:        'rosnode info /slam' on host within 20s
Restart:      on-failure
Stop:         TERM, then KILL after 20s
Handoff:      stop-first; safe when 'at-rest' on robot within 5.0s; within 30s; save 'map save' on host within 20s; load 'map load' on host within 20s
State:        save 'map save' while inactive; load 'map load'
Unreachable:  hold; stops itself after 1m00s
Environment:  API_KEY=***, MODE=fast
Placed:       edge1 since 2025-11-21T01:49:00Z
Downtimes:    edge1: 0.8s, 1.2s; edge2: 2.0s
Decision:     keep: pinned to edge1
On edge1:
  State:       ready
  Since:       2025-11-21T01:49:08Z (4m12s)
  Process:     4242
  Restarts:    1
  Last exit:   3
  Generation:  7
  Instance:    instance-1
Usage on edge1:
  RESOURCE     USED  DEMAND    EXCESS
  cpu          2.50    2.00     +0.50
  memory    512.0Mi   1.0Gi  -512.0Mi
  network   2.0MB/s       -         -
"""
    + HAPPENED
)


def test_an_edge_as_text() -> None:
    assert host("edge1") == EDGE1
    assert host("edge1", look=RenderOptions(width=160, unicode=True)) == EDGE1.replace(
        "  90%!", "  ███████▎  90%!"
    ).replace("  25%   1", "  ██        25%   1").replace("  40%   4", "  ███▎      40%   4")


def test_a_task_as_text() -> None:
    assert task() == SLAM_TEXT
    assert task(look=RenderOptions(width=160, unicode=True)) == SLAM_TEXT


def test_80_columns_are_enough() -> None:
    narrow = RenderOptions(width=80, unicode=True)
    assert max(map(len, (host("edge1", look=narrow) + task(look=narrow)).splitlines())) <= 80
    assert "robot:=robot1\n              with:=a-rather-long-line-of-arguments and:=more\n" in task(
        look=narrow
    ), "it goes on below itself"


def test_a_silent_host_and_one_that_is_never_asked() -> None:
    text = host("edge2")
    assert "Status:      unreachable\nCause:       connection refused\n" in text
    assert "Capacity:    2.00 cores, 1.0Gi (declared)\n" in text
    assert "Status:      not probed\n" in host("robot2")
    assert "Onboard:     candidate for its own tasks\n" in host("robot1")


def test_what_an_application_says_of_itself_stands_with_its_run() -> None:
    over = a_run(TaskState.COMPLETED, pid=0, metrics={"fps": 29.97, "\x1b[31mloss": 2.0})
    text = task("stray", value=snapshot(edge2=a_sample(tasks={"stray": over})))
    assert "Metrics on edge2:\n  fps           29.97\n  \\x1b[31mloss  2\n" in text


def test_a_task_that_does_not_run_and_one_that_no_file_names() -> None:
    assert "State:        not running\n" in task("idle")
    stray = snapshot(
        robot1=a_sample(
            tasks={"stray": a_run(TaskState.FAILED, exit_code=2, log_tail=("Traceback", "\x1b[31mboom"))}
        )
    )
    text = task("stray", value=stray)
    assert "Command:   not in the task files\n" in text
    assert "Last output:\n  Traceback\n  \\x1b[31mboom\n" in text


@pytest.mark.parametrize("form", [OutputFormat.TABLE, OutputFormat.JSON, OutputFormat.YAML])
def test_secrets_stay_hidden(form: OutputFormat) -> None:
    for text in (host("edge1", form), task(form=form)):
        assert "canary" not in text
        assert "***" in text


def test_the_container_of_a_task() -> None:
    image = ContainerImage(name="lab:5000/slam:1", gpus="all", volumes=("/srv:/srv",), ipc="private")
    found = TaskDetailsView("t", snapshot(), FLEET, some_tasks(a_task("t", image=image)), None, None)
    assert "Image:        lab:5000/slam:1, gpus all, ipc private, /srv:/srv\n" in found.table()
    assert json.loads(json.dumps(found.item()))["spec"]["image"] == "lab:5000/slam:1"
    assert json.loads(task(form=OutputFormat.JSON))["item"]["spec"]["image"] is None


def test_documents() -> None:
    whole = json.loads(host("edge1", OutputFormat.JSON))
    document = whole["item"]
    assert (whole["kind"], document["mark"], document["env"]["TOKEN"], document["contacted_at"]) == (
        "edge",
        "cordoned",
        "***",
        "2025-11-21T01:53:18.500Z",
    )
    assert [event["kind"] for event in document["events"]] == ["task-started", "task-restarted"]
    assert yaml.safe_load(host("edge1", OutputFormat.YAML)) == whole
    whole = json.loads(task(form=OutputFormat.JSON))
    document = whole["item"]
    run = document["runs"][0]
    assert (run["cpu"]["excess_cores"], run["memory"]["excess_bytes"]) == (0.5, -0.5 * GI)
    assert run["network"] == {"used_bytes_per_s": 2e6}
    assert document["downtimes_s"] == {"edge1": [0.75, 1.25], "edge2": [2]}
    assert (document["decision"]["action"], document["placement"]["host"], document["spec"]["needs"]) == (
        "keep",
        "edge1",
        [{"task": "pose", "until": "running"}],
    )
    assert yaml.safe_load(task(form=OutputFormat.YAML)) == whole
