# SPDX-License-Identifier: Apache-2.0
"""Meaning of valid files: expansion per robot, placeholders, needs, defaults, warnings."""

import json
import re
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory, load_inventory_and_tasks, load_tasks
from edgectl.errors import InputError, Problem
from edgectl.model.check import Check, CheckLocation
from edgectl.model.demand import Demand, Quantity
from edgectl.model.image import ContainerEngine, ContainerImage, PullPolicy
from edgectl.model.inventory import BaseLoad, Capacity, Connection, Inventory, Limits
from edgectl.model.policy import PolicyName, SequenceRule, Weights
from edgectl.model.task import (
    DetectRule,
    HandoffContract,
    HandoffOrder,
    HostRules,
    Need,
    NeedCondition,
    OnboardRule,
    StopRule,
    Task,
    TaskKind,
    Tasks,
    UnreachablePolicy,
)
from tests.config.broken_files import INVENTORY, TASKS


def load_files(
    directory: Path, tasks: str, inventory: str = INVENTORY
) -> tuple[Inventory, Tasks, tuple[Problem, ...]]:
    (directory / "i.yaml").write_text(inventory)
    (directory / "t.yaml").write_text(tasks)
    return load_inventory_and_tasks(directory / "i.yaml", directory / "t.yaml")


def load_task(directory: Path, keys: str, name: str = "t") -> Task:
    return load_files(
        directory, f"version: 1\ntasks:\n  s: {{for_each: robot, command: s}}\n  t: {{command: x, {keys}}}\n"
    )[1].tasks[name]


def test_hosts(tmp_path: Path) -> None:
    inventory = load_files(tmp_path, TASKS)[0]
    assert list(inventory.hosts) == ["edge1", "edge2", "edge3", "robot1", "robot2"]
    assert inventory.hosts["edge1"].user == "jetson"
    assert inventory.hosts["edge1"].env == {"ROS_DOMAIN_ID": "7"}
    assert inventory.hosts["edge2"].limits == Limits(cpu=0.8)
    assert inventory.hosts["edge3"].capacity == Capacity(cpu=2.0, memory=4.0 * 2**30)
    assert inventory.hosts["edge3"].base == BaseLoad(cpu=0.5)
    assert inventory.links == {("edge1", "robot1"): 6.75e6}
    assert inventory.probe_links
    assert not load_files(tmp_path, TASKS, "probe_links: false\n" + INVENTORY)[0].probe_links
    assert [host.onboard for host in inventory.robots] == [True, False]


def test_defaults_are_merged_key_by_key(tmp_path: Path) -> None:
    text = """\
version: 1
defaults: {env: {A: "1", B: "1"}, labels: {x: a}, limits: {cpu: 50%, memory: 60%}, identity_file: ~/.ssh/lab, port: 2222}
edges:
  edge10: {connection: local}
  edge9: {host: h, env: {B: "2"}, labels: {y: b}, limits: {cpu: 120%}, port: 22}
"""
    (tmp_path / "i.yaml").write_text(text)
    hosts = load_inventory(tmp_path / "i.yaml").hosts
    assert list(hosts) == ["edge9", "edge10"]
    assert hosts["edge9"].env == {"A": "1", "B": "2"}
    assert hosts["edge9"].labels == {"x": "a", "y": "b"}
    assert hosts["edge9"].limits == Limits(cpu=1.2, memory=0.6)
    assert (hosts["edge9"].port, hosts["edge10"].port) == (22, 2222)
    assert hosts["edge9"].identity_file == str(Path.home() / ".ssh/lab")
    assert (hosts["edge10"].connection, hosts["edge10"].host) == (Connection.LOCAL, "127.0.0.1")


def test_one_task_per_robot_with_placeholders(tmp_path: Path) -> None:
    tasks = load_files(tmp_path, TASKS)[1].tasks
    assert list(tasks) == [
        "map-merge",
        "navigation-robot1",
        "navigation-robot2",
        "pose",
        "slam-robot1",
        "slam-robot2",
    ]
    slam = tasks["slam-robot2"]
    assert (slam.template, slam.robots) == ("slam", ("robot2",))
    assert slam.command == "roslaunch slam.launch robot:=robot2"
    assert slam.ready == Check(command="rosnode info /robot2/slam", timeout=20.0)
    assert slam.demand["cpu"] == Quantity(value=35.2 / 100, relative=True)
    assert tasks["navigation-robot1"].env == {"ROBOT": "robot1"}
    assert tasks["navigation-robot1"].demand["memory"] == Quantity(value=90.0 * 2**20)


def test_needs_are_of_the_same_robot_or_of_all(tmp_path: Path) -> None:
    tasks = load_files(tmp_path, TASKS)[1].tasks
    assert tasks["navigation-robot2"].needs == (Need(task="slam-robot2"),)
    assert tasks["map-merge"].needs == (Need(task="slam-robot1"), Need(task="slam-robot2"))
    assert tasks["map-merge"].robots == ("robot1", "robot2")
    assert load_task(
        tmp_path, "needs: [slam2, {task: s-robot2, until: completed}]".replace("slam2, ", "")
    ).needs == (Need(task="s-robot2", until=NeedCondition.COMPLETED),)


def test_only_exact_placeholders_are_filled_in(tmp_path: Path) -> None:
    command = "echo {robot} {robot_host} ${robot} ${HOME} {a,b} {robots} {{robot}} { robot } '{}'"
    got = load_task(
        tmp_path,
        f'robot: robot1, workdir: "/srv/{{robot}}", env: {{H: "{{robot_host}}"}}, ready: "{command}"',
    )
    assert got.ready is not None
    assert (
        got.ready.command
        == "echo robot1 192.168.1.21 ${robot} ${HOME} {a,b} {robots} {robot1} { robot } '{}'"
    )
    assert (got.workdir, got.env) == ("/srv/robot1", {"H": "192.168.1.21"})


def test_without_one_robot_shell_braces_still_survive(tmp_path: Path) -> None:
    assert load_task(tmp_path, "ready: 'ls {a,b} ${robot}'").ready == Check(command="ls {a,b} ${robot}")


def test_robots_of_a_regular_expression_are_escaped(tmp_path: Path) -> None:
    inventory = INVENTORY.replace("robot1", "r.1")
    tasks = "version: 1\ntasks: {t: {for_each: [r.1], managed: false, detect: {cmdline: 'node /{robot}$'}}}"
    got = load_files(tmp_path, tasks, inventory)[1].tasks["t-r.1"]
    assert got.detect == DetectRule(cmdline=r"node /r\.1$")
    assert (got.managed, got.command) == (False, "")


def test_short_and_long_forms(tmp_path: Path) -> None:
    assert load_task(tmp_path, "stop: ros").stop == StopRule(signal="INT", preset="ros")
    assert load_task(tmp_path, "stop: {preset: ros, grace: 5s}").stop == StopRule(
        signal="INT", grace=5.0, preset="ros"
    )
    assert load_task(tmp_path, "stop: {signal: HUP, grace: 0}").stop == StopRule(signal="HUP", grace=0.0)
    assert load_task(tmp_path, "done_when: test -f x").done_when == Check(command="test -f x")
    assert load_task(
        tmp_path, "robot: robot1, done_when: {command: x, on: robot, timeout: 1m}"
    ).done_when == Check(command="x", on=CheckLocation.ROBOT, timeout=60.0)
    replaced = load_task(tmp_path, "on_unreachable: {policy: replace, after: 2m}, self_fence: 5m")
    assert (replaced.on_unreachable, replaced.replace_after) == (UnreachablePolicy.REPLACE, 120.0)
    assert replaced.self_fence == 300.0
    assert (
        replaced.spec_hash
        != load_task(tmp_path, "on_unreachable: {policy: replace, after: 2m}, self_fence: 6m").spec_hash
    )
    assert load_task(
        tmp_path, "hosts: {only: [edge2, edge1], labels: {gpu: maxwell}, pin: edge1}"
    ).hosts == HostRules(only=("edge1", "edge2"), labels={"gpu": "maxwell"}, pin="edge1")
    assert load_task(tmp_path, "kind: job, onboard: never, priority: -2, deadline: 1h30m").deadline == 5400.0


def test_hooks_run_on_the_robot_unless_they_say_host(tmp_path: Path) -> None:
    got = load_task(
        tmp_path,
        "robot: robot1, handoff: {order: start-first, safe_when: 'a {robot}', hold: {command: b, on: host}}",
    )
    assert got.handoff == HandoffContract(
        order=HandoffOrder.START_FIRST,
        safe_when=Check(command="a robot1", on=CheckLocation.ROBOT),
        hold=Check(command="b"),
    )


def test_policy_keys(tmp_path: Path) -> None:
    text = "version: 1\npolicy: static\nsequence: sensitivity\nweights: {cpu: 3, task: 1}\nmove_margin: 0\nmin_dwell: 0\nmax_moves: unlimited\n"
    policy = load_files(tmp_path, text + "tasks: {}\n")[1].policy
    assert (policy.name, policy.sequence, policy.weights) == (
        PolicyName.STATIC,
        SequenceRule.SENSITIVITY,
        Weights(cpu=0.75, memory=0.0, network=0.0, task=0.25),
    )
    assert (policy.move_margin, policy.min_dwell, policy.max_moves) == (0.0, 0.0, None)


def test_a_fleet_has_its_stated_name_or_one_of_its_path(tmp_path: Path) -> None:
    """A derived name is the same for every call, another for every file, and no part of the digest."""
    text = INVENTORY.replace("fleet: lab\n", "")
    named, _, none = load_files(tmp_path, TASKS)
    assert ({host.fleet for host in named.hosts.values()}, named.fleet, none) == ({"lab"}, "lab", ())
    unnamed, _, (warning,) = load_files(tmp_path, TASKS, text)
    assert re.fullmatch("i-[0-9a-f]{8}", unnamed.fleet)
    assert {host.fleet for host in unnamed.hosts.values()} == {unnamed.fleet}
    assert (warning.code, warning.hint) == ("EC103", f"add fleet: {unnamed.fleet}")
    assert load_files(tmp_path, TASKS, text)[0] == unnamed
    (tmp_path / "other").mkdir()
    other = load_files(tmp_path / "other", TASKS, text)[0]
    assert (other.digest, other.fleet == unnamed.fleet) == (unnamed.digest, False)
    assert (
        named.digest != load_files(tmp_path, TASKS, INVENTORY.replace("fleet: lab", "fleet: hall"))[0].digest
    )
    odd = tmp_path / "Unser Labor (neu).yaml"
    odd.write_text(text)
    assert load_inventory(odd).fleet.startswith("unser-labor-neu-")


def test_demand_left_out_is_a_warning(tmp_path: Path) -> None:
    tasks = """\
version: 1
tasks:
  a: {command: x}
  b: {command: x, robot: robot1, demand: {cpu: 1, memory: 0}}
  c: {command: x, demand: {cpu: 1, memory: 0}}
  d: {managed: false, detect: {cmdline: x}}
"""
    warnings = load_files(tmp_path, tasks)[2]
    assert [(p.line, p.column, p.code, p.warning) for p in warnings] == [
        (3, 3, "EC101", True),
        (4, 42, "EC101", True),
    ]
    assert warnings[0].message == "a states no demand for cpu, memory: counted as 0 until it is measured"
    assert warnings[1].message == "b states no demand for throughput: counted as 0 until it is measured"


def test_a_check_on_a_robot_that_is_never_contacted_is_a_warning(tmp_path: Path) -> None:
    inventory = INVENTORY.replace("{host: 192.168.1.22}", "{host: 192.168.1.22, probe: false}")
    tasks = "version: 1\ntasks: {t: {robot: robot2, command: x, demand: {cpu: 1, memory: 1, throughput: 1}, done_when: {on: robot, command: y}}}"
    (warning,) = load_files(tmp_path, tasks, inventory)[2]
    assert (warning.code, warning.hint) == ("EC102", "write on: host, or remove probe: false")


@pytest.mark.parametrize(
    ("command", "warned"),
    [("run &", True), ("run & # x\nwait", False), ("run 2>&1", False), ("a && b", False), ("run&\n", True)],
)
def test_a_command_that_goes_to_the_background_is_a_warning(
    command: str, warned: bool, tmp_path: Path
) -> None:
    tasks = f"version: 1\ntasks: {{t: {{command: {json.dumps(command)}, demand: {{cpu: 1, memory: 1, throughput: 1}}}}}}"
    found = load_files(tmp_path, tasks)[2]
    assert [(each.code, each.hint) for each in found] == (
        [("EC106", "drop the & at its end")] if warned else []
    )


def test_a_missing_identity_file_is_a_warning(tmp_path: Path) -> None:
    (tmp_path / "key").touch()
    for name, codes in (("key", []), ("other", ["EC105"])):
        inventory = INVENTORY.replace(
            "{host: 192.168.1.22}", f"{{host: a, identity_file: {tmp_path / name}}}"
        )
        tasks = "version: 1\ntasks: {t: {command: x, demand: {cpu: 1, memory: 1, throughput: 1}}}"
        assert [each.code for each in load_files(tmp_path, tasks, inventory)[2]] == codes


def test_tasks_of_several_files_and_directories(tmp_path: Path) -> None:
    (tmp_path / "i.yaml").write_text(INVENTORY)
    (tmp_path / "d").mkdir()
    (tmp_path / "d/a.yaml").write_text("version: 1\nweights: cpu\ntasks: {a: {command: x}}\n")
    (tmp_path / "d/b.yml").write_text("version: 1\nweights: cpu\ntasks: {b: {command: x, needs: [a, c]}}\n")
    (tmp_path / "d/notes.txt").write_text("not: [read")
    (tmp_path / "c.yaml").write_text("version: 1\ntasks: {c: {command: x}}\n")
    inventory = load_inventory(tmp_path / "i.yaml")
    tasks = load_tasks([tmp_path / "d", tmp_path / "c.yaml", tmp_path / "c.yaml"], inventory)
    assert list(tasks.tasks) == ["a", "b", "c"]
    (tmp_path / "c.yaml").write_text("version: 1\nweights: memory\ntasks: {a: {command: x}}\n")
    with pytest.raises(InputError) as caught:
        load_tasks([tmp_path / "d", tmp_path / "c.yaml"], inventory)
    assert [(p.line, p.code) for p in caught.value.problems if p.file.endswith("c.yaml")] == [
        (2, "EC032"),
        (3, "EC032"),
    ]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty: no"):
        load_tasks(tmp_path / "empty", inventory)


def test_shapes_of_tasks_are_checked_even_where_the_inventory_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_files(tmp_path, TASKS.replace("cpu: 500m", "cpu: -1"), "edges: [")
    assert [p.code for p in caught.value.problems] == ["EC004", "EC015"]


def test_too_many_tasks_are_refused_before_they_are_made(tmp_path: Path) -> None:
    inventory = "version: 1\nfleet: lab\nrobots:\n" + "".join(f"  r{i}: {{host: h}}\n" for i in range(2000))
    with pytest.raises(InputError) as caught:
        load_files(
            tmp_path,
            "version: 1\ntasks:\n" + "".join(f"  t{i}: {{for_each: robot, command: x}}\n" for i in range(9)),
            inventory,
        )
    assert [p.code for p in caught.value.problems] == ["EC034"]


def test_onboard_only(tmp_path: Path) -> None:
    assert load_task(tmp_path, "robot: robot1, onboard: only").onboard is OnboardRule.ONLY
    assert load_task(tmp_path, "robot: robot1, hosts: {pin: robot1}").hosts.pin == "robot1"
    assert load_task(tmp_path, "kind: job").kind is TaskKind.JOB


def test_demands_may_be_measured(tmp_path: Path) -> None:
    tasks = """version: 1
tasks:
  a: {command: x, demand: measured}
  b: {command: x, robot: robot1, demand: {cpu: measured, memory: {until_measured: 90Mi}, throughput: {until_measured: 10%}}}
  c: {command: x, demand: {cpu: {until_measured: 0}, memory: 1}}
"""
    _, read, warnings = load_files(tmp_path, tasks)
    found = read.tasks
    measured = Quantity(value=0.0, measured=True)
    assert found["a"].demand == Demand(cpu=measured, memory=measured, network=measured)
    assert found["b"].demand == Demand(
        cpu=measured,
        memory=Quantity(value=90.0 * 2**20, measured=True),
        network=Quantity(value=0.1, relative=True, measured=True),
    )
    assert found["c"].demand == Demand(cpu=measured, memory=Quantity(value=1.0))
    assert not warnings


def test_an_image_by_name_and_as_a_mapping(tmp_path: Path) -> None:
    short = load_task(tmp_path, "robot: robot1, image: 'ros:jazzy'")
    assert short.image == ContainerImage(name="ros:jazzy")
    assert (short.image.network, short.image.ipc, short.image.pull) == ("host", "host", PullPolicy.MISSING)
    written = (
        "{name: 'lab:5000/a@sha256:00', engine: podman, gpus: 2, devices: [/dev/video0], user: '1000:1000',"
        " volumes: ['~/maps/{robot}:/maps:ro'], env: {MAP: '{robot_host}'}, network: none, ipc: private,"
        " pull: always, args: ['--label=robot={robot}']}"
    )
    full = load_task(tmp_path, f"robot: robot1, image: {written}")
    assert full.image == ContainerImage(
        name="lab:5000/a@sha256:00",
        engine=ContainerEngine.PODMAN,
        gpus="2",
        devices=("/dev/video0",),
        volumes=("~/maps/robot1:/maps:ro",),
        env={"MAP": "192.168.1.21"},
        user="1000:1000",
        network="none",
        ipc="private",
        pull=PullPolicy.ALWAYS,
        args=("--label=robot=robot1",),
    )
    assert full.spec_fields.keys() - short.spec_fields.keys() == set()
    assert short.spec_fields["image"] != full.spec_fields["image"]
    assert "image" not in load_task(tmp_path, "robot: robot1").spec_fields


def test_an_image_needs_no_command(tmp_path: Path) -> None:
    inventory, tasks, problems = load_files(
        tmp_path, "version: 1\ntasks: {t: {image: 'ros:jazzy', demand: {cpu: 0, memory: 0}}}"
    )
    assert (tasks.tasks["t"].command, problems) == ("", ())
    assert inventory.hosts
