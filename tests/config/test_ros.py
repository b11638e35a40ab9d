# SPDX-License-Identifier: Apache-2.0
"""``ros`` of hosts and questions to the ROS graph: what is read, what follows from it, what is warned of."""

import re
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory_and_tasks
from edgectl.errors import InputError, Problem
from edgectl.model.check import AliveRule, Check, CheckLocation, OnUnhealthy
from edgectl.model.inventory import Inventory
from edgectl.model.ros import RosCheck, RosSettings, RosTopic
from edgectl.model.task import NeedRestart, Tasks
from edgectl.rules.environment import merge_environment
from edgectl.rules.ros import encode_ros, list_ros_packages

INVENTORY = """\
version: 1
fleet: lab
defaults: {ros: {version: 1, setup: [/opt/ros/noetic/setup.bash], master: edge1}}
edges:
  edge1: {host: 10.0.0.11}
  edge2: {host: 10.0.0.12, ros: {setup: [~/ws/devel/setup.bash]}}
robots:
  robot1: {host: 10.0.0.21}
  robot2: {host: 10.0.0.22, ros: {version: 2, domain: 7}}
"""
DEMAND = "demand: {cpu: 1, memory: 1Mi, throughput: 0}"


def load(
    tmp_path: Path, tasks: str, inventory: str = INVENTORY
) -> tuple[Inventory, Tasks, tuple[Problem, ...]]:
    (tmp_path / "i.yaml").write_text(inventory)
    (tmp_path / "t.yaml").write_text(f"version: 1\ntasks:\n{tasks}")
    return load_inventory_and_tasks(tmp_path / "i.yaml", tmp_path / "t.yaml")


def a_task_text(name: str, **keys: str) -> str:
    stated = "".join(f"    {key}: {value}\n" for key, value in ({"command": "run"} | keys).items())
    return f"  {name}:\n    {DEMAND}\n{stated}"


def list_warnings(tmp_path: Path, tasks: str, inventory: str = INVENTORY) -> list[str]:
    return [each.message for each in load(tmp_path, tasks, inventory)[2] if each.code == "EC108"]


def test_settings_are_merged_key_by_key(tmp_path: Path) -> None:
    """Those of defaults that are of the other ROS do not count."""
    hosts = load(tmp_path, a_task_text("t"))[0].hosts
    master = "http://10.0.0.11:11311"
    assert hosts["edge1"].ros == RosSettings(version=1, setup=("/opt/ros/noetic/setup.bash",), master=master)
    assert hosts["edge2"].ros == RosSettings(version=1, setup=("~/ws/devel/setup.bash",), master=master)
    assert hosts["robot2"].ros == RosSettings(version=2, setup=("/opt/ros/noetic/setup.bash",), domain=7)


def test_the_environment_of_a_task_follows_and_what_is_stated_wins(tmp_path: Path) -> None:
    inventory, tasks, _ = load(
        tmp_path,
        a_task_text("t", robot="robot1", command='"rosrun slam node {host_address} {robot}"')
        + a_task_text("u", env="{ROS_HOSTNAME: me, ROS_MASTER_URI: 'http://other:1'}"),
    )
    edge = inventory.hosts["edge1"]
    seen = merge_environment(tasks.tasks["t"], edge, inventory.hosts)
    assert (seen["ROS_MASTER_URI"], seen["ROS_IP"]) == ("http://10.0.0.11:11311", "{host_address}")
    stated = merge_environment(tasks.tasks["u"], edge, inventory.hosts)
    assert (stated["ROS_MASTER_URI"], stated["ROS_HOSTNAME"]) == ("http://other:1", "me")
    assert "ROS_IP" not in stated
    assert encode_ros(tasks.tasks["t"], edge, inventory.hosts) == {
        "version": 1,
        "setup": ["/opt/ros/noetic/setup.bash"],
        "peers": ["10.0.0.21", "10.0.0.11"],
        "values": {"robot_address": "10.0.0.21", "master": "http://10.0.0.11:11311"},
    }
    assert list_ros_packages(tasks.tasks, edge) == {"slam": "t"}


def test_questions_to_the_graph(tmp_path: Path) -> None:
    inventory = INVENTORY.replace(", ros: {version: 2, domain: 7}", "")
    task = load(
        tmp_path,
        a_task_text(
            "t",
            for_each="robot",
            alive="{ros_node: '{robot}/slam', ros_topic: '/{robot}/map', after: 5s}",
            on_unhealthy="restart",
            done_when="{ros_service: /done, on: robot}",
            needs="[{task: core, restart: with}]",
            handoff="{safe_when: {ros_topic: {name: /idle, within: 1s}}}",
        )
        + a_task_text("core"),
        inventory,
    )[1].tasks["t-robot1"]
    check = Check(ros=RosCheck(node="/robot1/slam", topic=RosTopic(name="/robot1/map")))
    assert task.alive == AliveRule(check=check, after=5.0, on_unhealthy=OnUnhealthy.RESTART)
    # what must be alive is not ready before it is
    assert task.ready == check
    assert task.done_when == Check(on=CheckLocation.ROBOT, ros=RosCheck(service="/done"))
    assert task.handoff.safe_when == Check(
        on=CheckLocation.ROBOT, ros=RosCheck(topic=RosTopic(name="/idle", within=1.0))
    )
    assert task.needs[0].restart is NeedRestart.WITH


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("ready", "{timeout: 3s}", "a check needs command, or a question to the ROS graph"),
        ("ready", "{command: x, ros_node: /n}", "a check asks by command or by ros_node"),
        ("ready", "{ros_lifecycle: active}", "ros_lifecycle is the state of a node, and none is named"),
        ("ready", "{ros_node: 'a b'}", "'a b' is no name in the ROS graph"),
        ("alive", "{ros_node: /n, on: robot}", "unknown key on in alive"),
        ("on_unhealthy", "restart", "on_unhealthy without alive: nothing asks whether the task is alive"),
        (
            "restart",
            "never\n    alive: x\n    on_unhealthy: restart",
            "on_unhealthy: restart and restart: never do not go together",
        ),
        ("handoff", "{hold: {ros_node: /n}}", "unknown key ros_node in a hook"),
    ],
)
def test_wrong_questions(tmp_path: Path, key: str, value: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, a_task_text("t", **{key: value}))
    assert message in [problem.message for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("ros", "message"),
    [
        ("{version: 1, domain: 3}", "domain is a setting of ROS 2, and version is 1"),
        ("{setup: [/s]}", "ros needs version"),
        ("{version: 1, setup: [s.bash]}", "'s.bash' is no absolute path"),
        ("{version: 1, master: 'https://a:1'}", "'https://a:1' is no URI of a ROS master"),
        ("{version: 1, master: 'http://a$(x):1'}", "'http://a$(x):1' is no URI of a ROS master"),
    ],
)
def test_wrong_settings(tmp_path: Path, ros: str, message: str) -> None:
    inventory = f"version: 1\nfleet: lab\nedges: {{edge1: {{host: 10.0.0.1, ros: {ros}}}}}\n"
    with pytest.raises(InputError) as caught:
        load(tmp_path, a_task_text("t"), inventory)
    assert message in [problem.message for problem in caught.value.problems]


def test_nodes_that_never_meet(tmp_path: Path) -> None:
    mixed = INVENTORY.replace("10.0.0.12, ros: {", "10.0.0.12, ros: {master: edge2, ")
    task = a_task_text("t", robot="robot1")
    assert list_warnings(tmp_path, task, mixed) == [
        (
            "ROS_MASTER_URI of t is http://10.0.0.11:11311 on edge1 and http://10.0.0.12:11311 on edge2: "
            "their nodes never meet"
        )
    ]
    assert list_warnings(tmp_path, a_task_text("t", robot="robot1", hosts="{pin: edge1}"), mixed) == []


@pytest.mark.parametrize("word", ["__name:=slam", "-r __node:=slam", "__ns:=/lab __name:=slam"])
def test_one_node_name_twice(tmp_path: Path, word: str) -> None:
    one, other = (
        a_task_text("one", command=f'"rosrun p n {word}"'),
        a_task_text("two", command=f'"rosrun p n {word}"'),
    )
    name = "/lab/slam" if "ns" in word else "/slam"
    assert list_warnings(tmp_path, one + other) == [
        f"one and two start nodes of one name, {name}: in ROS 1 the second ends the first"
    ]
    per_robot = a_task_text("one", for_each="[robot1, robot2]", command='"rosrun p n __name:={robot}_slam"')
    apart = INVENTORY.replace(", ros: {version: 2, domain: 7}", "")
    assert list_warnings(tmp_path, per_robot, apart) == []


def test_a_question_without_a_graph_and_a_loopback_address(tmp_path: Path) -> None:
    plain = "version: 1\nfleet: lab\nedges: {edge1: {host: 10.0.0.1, env: {ROS_IP: 127.0.0.1}}}\n"
    assert list_warnings(tmp_path, a_task_text("t", alive="{ros_node: /n}"), plain) == [
        "ROS_IP of edge1 is 127.0.0.1, which means another machine on each host",
        "t asks the ROS graph on edge1, which has no ROS master",
    ]


def test_the_example_of_the_chapter_is_right(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/ros.md").read_text()
    inventory, tasks = re.findall(r"^```yaml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "i.yaml").write_text(inventory)
    (tmp_path / "t.yaml").write_text(tasks)
    loaded = load_inventory_and_tasks(tmp_path / "i.yaml", tmp_path / "t.yaml")
    assert set(loaded[1].tasks) == {"roscore", "slam-robot1", "camera-robot1"}
    assert loaded[2] == ()
