# SPDX-License-Identifier: Apache-2.0
"""docs/reference/files.md: every key that exists is documented, every documented key exists, and its examples
load.
"""

import re
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import pytest

from edgectl.config import (
    check_readers,
    coordination,
    demand_readers,
    image_readers,
    inventory_file,
    job_readers,
    latency_readers,
    project_file,
    ros_settings,
    standby_readers,
    task_file,
    task_readers,
)
from edgectl.config import fields as config_fields
from edgectl.config.load import load_inventory_and_tasks
from edgectl.config.problems import ProblemCode
from edgectl.experiments.files import experiment_file, run_codec, scenario_file
from edgectl.formats.kinds import PLAN_KIND, SNAPSHOT_KIND
from edgectl.model.inventory import Host, Role
from edgectl.model.latency import LatencySample
from edgectl.model.resource import HOST_RESOURCES
from edgectl.model.snapshot import (
    DeviceSample,
    HostSample,
    InterfaceSample,
    OtherTask,
    ResourceUsage,
    TaskSample,
    TaskState,
    TermRatings,
)
from edgectl.model.snapshot import HostStatus as Status
from edgectl.model.task import Task
from tests.config.test_bad_documents import PLAN, SNAPSHOT
from tests.experiments.test_run_codec import RUN, TRIAL

PAGE = (Path(__file__).parents[2] / "docs/reference/files.md").read_text()
TABLES: Mapping[str, tuple[Mapping[str, object], ...]] = {
    "## Inventory": (inventory_file.INVENTORY_KEYS,),
    "### Hosts": (
        inventory_file.EDGE_KEYS,
        {key: None for key in inventory_file.ROBOT_KEYS if key not in inventory_file.EDGE_KEYS},
    ),
    "### Coordination": (coordination.COORDINATION_KEYS,),
    "### ROS of a host": (ros_settings.ROS_KEYS,),
    "### Limits of a host": (inventory_file.LIMITS_KEYS,),
    "### Capacity": (inventory_file.CAPACITY_KEYS,),
    "### Base": (inventory_file.BASE_KEYS,),
    "### Links": (inventory_file.LINK_KEYS,),
    "## Tasks": (task_file.TASK_FILE_KEYS,),
    "### A task": (task_file.TASK_KEYS,),
    "### Jobs of a task": (job_readers.JOB_KEYS, job_readers.SERVICE_TIME_KEYS),
    "### Image": (image_readers.IMAGE_KEYS,),
    "### Demand": (demand_readers.DEMAND_KEYS,),
    "### Needs": (task_readers.NEED_KEYS,),
    "### Hosts of a task": (task_readers.HOST_RULES_KEYS,),
    "### Checks": (check_readers.CHECK_KEYS,),
    "### Liveness": (check_readers.ALIVE_KEYS,),
    "### Latency": (latency_readers.LATENCY_KEYS, latency_readers.DEADLINE_KEYS),
    "### Heard": (latency_readers.HEARD_KEYS,),
    "### Detect": (task_readers.DETECT_KEYS,),
    "### Stop": (task_readers.STOP_KEYS,),
    "### Secrets": (config_fields.SECRET_KEYS,),
    "### Handoff": (task_readers.HANDOFF_KEYS,),
    "### Standby": (standby_readers.STANDBY_KEYS,),
    "### State of a task": (standby_readers.STATE_KEYS,),
    "### Limits of a task": (task_readers.TASK_LIMITS_KEYS,),
    "### Log": (task_readers.LOG_KEYS,),
    "### Unreachable hosts": (task_readers.ON_UNREACHABLE_KEYS,),
    "## Project": (project_file.PROJECT_KEYS,),
    "### Contexts": (project_file.CONTEXT_KEYS,),
    "### Defaults of options": (project_file.DEFAULTS_KEYS,),
    "### User configuration": ({"safe_directories": None},),
    "## Experiment": (experiment_file.EXPERIMENT_KEYS,),
    "### Schemes": (experiment_file.SCHEMES_KEYS,),
    "### Maps": (experiment_file.MAP_PAIR_KEYS,),
    "## Scenario": (scenario_file.SCENARIO_KEYS,),
    "### Simulated hosts": (scenario_file.SIM_HOST_KEYS,),
    "### Simulated jobs": (scenario_file.JOB_KEYS,),
    "### Timing": (scenario_file.TIMING_KEYS,),
    "### Simulated links": (scenario_file.LINK_KEYS,),
}


def read_section(heading: str) -> str:
    """Return the text below a heading, up to the next one."""
    assert f"\n{heading}\n" in PAGE, heading
    return re.split(r"\n##", PAGE.split(f"\n{heading}\n", 1)[1], maxsplit=1)[0]


def read_tables(heading: str) -> list[list[str]]:
    """Return the first columns of the tables below a heading, without their headings."""
    found: list[list[str]] = []
    inside = False
    for line in read_section(heading).split("\n"):
        if line.startswith("|---"):
            found.append([])
            inside = True
        elif line.startswith("| `") and inside:
            found[-1].append(line.split("`")[1])
        else:
            inside = False
    return found


@pytest.mark.parametrize("heading", TABLES)
def test_tables_hold_every_key_in_order(heading: str) -> None:
    assert [sorted(keys) for keys in read_tables(heading)] == [sorted(table) for table in TABLES[heading]]


def test_codes_are_complete() -> None:
    assert read_tables("## Problems") == [[code.value for code in ProblemCode]]


def test_readers_cover_the_model() -> None:
    """Every field of Host and Task is read from a file, or set by edgectl."""
    assert set(inventory_file.ROBOT_KEYS) == {field.name for field in fields(Host)} - {
        "name",
        "role",
        "fleet",
    }
    made = {"name", "template", "spec_hash", "spec_fields", "replace_after", "hard_deadline", "file"}
    assert (
        set(task_file.TASK_KEYS) - {"for_each", "robot", "on_unhealthy"}
        == {field.name for field in fields(Task)} - made
    )


def test_keys_of_a_snapshot_are_complete() -> None:
    everything = TaskSample(
        state=TaskState.FAILED, links={}, instance="i", spec_hash="s", generation=1, managed=False, restarts=1, exit_code=1, detail="d",
        fields={"command": "c"}, last_exit=1, log_tail=("l",), limits="l", given_up=True, metrics={"fps": 29.5}, ended_at=1.0, file="f", orphaned=True, adoptable=True, needed="a1b2c3", nodes={"/slam": "http://edge1:1"}, partial="udp unseen", latency=LatencySample(count=1), switching=True, deactivated=7, container="edgectl-lab-edge1-slam",
    )  # fmt: skip
    device = DeviceSample(
        load_1m=1.0,
        temperature_c=1.0,
        gpu_share=1.0,
        power_w=1.0,
        boot_id="b",
        pid_namespace="pid:[1]",
        clock_skew_s=1.0,
        interfaces={"eth0": InterfaceSample(rx_bytes_per_s=1, tx_bytes_per_s=1)},
    )
    other = OtherTask(fleet="f", host="h", task="t", state=TaskState.READY)
    sample = HostSample(
        role=Role.EDGE,
        status=Status.OK,
        error="e",
        error_kind="k",
        hint="h",
        usage={resource.name: ResourceUsage(capacity=1.0, used=0.5) for resource in HOST_RESOURCES},
        tasks={"t": everything},
        standbys={"t": everything},
        generations={"t": 2},
        other_tasks=(other,),
        foreign_tasks=(other,),
        resident=True,
        device=device,
        address="ana@10.0.0.1",
        machine="m/1000/a",
        counters="installed",
        engines=("docker",),
    )
    document = SNAPSHOT_KIND.encode(
        type(SNAPSHOT)(
            taken_at=0.0,
            hosts={"h": sample},
            manager=SNAPSHOT.manager,
            ratings={"heat": TermRatings(package="lab 0.1", tasks={"t": {"h": 0.5}})},
        )
    )
    encoded = document["hosts"]["h"]  # type: ignore[index]
    assert read_tables("## Snapshot") == [list(document), list(encoded), list(encoded["tasks"]["t"])]
    assert all(f"`{key}` ?" in read_section("## Snapshot") for key in encoded["device"])


def test_keys_of_a_plan_are_complete() -> None:
    document = PLAN_KIND.encode(PLAN)
    whole, decision = read_tables("## Plan")
    encoded = document["decisions"][0]  # type: ignore[index]
    section = read_section("## Plan").split("Of a decision.")
    assert [key for key in whole if f"| `{key}` ? |" not in section[0]] == list(document)
    assert [key for key in decision if f"| `{key}` ? |" not in section[1]] == list(encoded)
    assert all(f"`{key}`" in read_section("## Plan") for key in encoded["ranking"][0])


def test_keys_of_runs_and_trials_are_complete() -> None:
    document = run_codec.RUN_KIND.encode(RUN)
    (head,), (trial,) = read_tables("## Run"), read_tables("## Trial")
    assert [*head, "trials"] == list(document)
    assert trial == list(run_codec.TRIAL_KIND.encode(TRIAL))
    assert all(f"`{key}`" in read_section("## Run") for key in document["experiment"])  # type: ignore[attr-defined]


def test_the_examples_load_together(tmp_path: Path) -> None:
    blocks = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "i.yaml").write_text(blocks[0])
    (tmp_path / "t.yaml").write_text(blocks[1])
    _, tasks, warnings = load_inventory_and_tasks(tmp_path / "i.yaml", tmp_path / "t.yaml")
    assert list(tasks.tasks) == ["navigation-robot1", "slam-robot1"]
    assert not warnings
