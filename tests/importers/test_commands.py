# SPDX-License-Identifier: Apache-2.0
"""The commands ``edgectl import``, from files of other tools to a plan."""

import os
from pathlib import Path

import pytest

from edgectl.config.load import load_inventory, load_inventory_and_tasks
from edgectl.transport.ssh_config import SshConfigResolver
from tests.cli.inprocess import Said, edgectl
from tests.importers.test_launch_files import CORPUS
from tests.views.fixtures import ROOT, SNAPSHOT

HOSTS_INI = """\
bastion ansible_host=192.168.1.2

[edges]
jetson[01:02] ansible_port=2222
edge-b ansible_host=10.0.0.7 ansible_user=root  # the old one

[edges:vars]
ansible_user=ubuntu
ansible_ssh_private_key_file=~/.ssh/lab
ansible_password=secret7
ansible_ssh_common_args='-o ProxyJump=bastion'

[gpu]
jetson01
[lab:children]
edges
[local]
here ansible_connection=local
[all:vars]
ansible_host={{ inventory_hostname }}.lab
room=7
"""
HOSTS_YAML = """\
all:
  vars: {ansible_host: "{{ inventory_hostname }}.lab", room: 7}
  hosts:
    bastion: {ansible_host: 192.168.1.2}
  children:
    edges:
      vars:
        ansible_user: ubuntu
        ansible_ssh_private_key_file: ~/.ssh/lab
        ansible_password: secret7
        ansible_ssh_common_args: -o ProxyJump=bastion
      hosts:
        jetson[01:02]: {ansible_port: 2222}
        edge-b: {ansible_host: 10.0.0.7, ansible_user: root}
    gpu: {hosts: {jetson01: }}
    lab: {children: {edges: }}
    local: {hosts: {here: {ansible_connection: local}}}
"""
EDGES = """\
edges:
  bastion: {host: 192.168.1.2}
  jetson01: {host: jetson01, user: ubuntu, port: 2222, identity_file: '~/.ssh/lab', proxy_jump: bastion, labels: {edges: 'true', gpu: 'true', lab: 'true'}}
  jetson02: {host: jetson02, user: ubuntu, port: 2222, identity_file: '~/.ssh/lab', proxy_jump: bastion, labels: {edges: 'true', lab: 'true'}}
  edge-b: {host: 10.0.0.7, user: root, identity_file: '~/.ssh/lab', proxy_jump: bastion, labels: {edges: 'true', lab: 'true'}}
  here: {connection: local, labels: {local: 'true'}}
"""
REQUIREMENTS = """\
task_seq:
    - R2_Navigation
    - R1_Navigation
    - Map_Merging
task_req: {
  'R1_SLAM' : [35.195, 2.5, 2.53],
  'R1_Navigation': [2.705, 2.33, 2.328],
  'R2_SLAM' : [35.195, 2.5, 2.53],
  'R2_Navigation': [2.705, 2.33, 2.328],
  'Map_Merging': [9.607, 2.83, 3.620]
}
weights: {
  'CPU' : [1, 0, 0, 0],
  'all' : [0.25, 0.25, 0.25, 0.25],
  'new' : [0.33, 0.33, 0.33, 0.0]
}
task_req_seq: {
  'R1_Navigation': ['R1_SLAM','R1_Navigation'],
  'R2_Navigation': ['R1_SLAM','R2_Navigation'],
  'Map_Merging': ['R1_SLAM','R2_SLAM','Map_Merging']
}
commands: {
  'R1_SLAM' : 'nohup roslaunch edge_robot slam_1.launch &',
  'R1_Navigation' : 'nohup roslaunch edge_robot nav_1.launch > /tmp/nav.log 2>&1 &',
  'R2_SLAM' : 'nohup roslaunch edge_robot slam_2.launch &',
  'R2_Navigation' : 'nohup roslaunch edge_robot nav_2.launch &'
}
"""


def run(directory: Path, *words: str, **env: str) -> Said:
    return edgectl(words, directory, {**os.environ, "EDGECTL_STATE_DIR": str(directory / "state"), **env})


def test_a_launch_file_is_imported_validated_and_planned(tmp_path: Path) -> None:
    said = run(tmp_path, "import", "ros", str(CORPUS / "robots.launch"), "--out", "lab")
    assert (said.code, said.out) == (0, "wrote lab/inventories/robots.yaml\nwrote lab/tasks/robots.yaml\n")
    assert said.err == "next: edgectl validate -i lab/inventories/robots.yaml -t lab/tasks/robots.yaml\n"
    files = ("-i", "lab/inventories/robots.yaml", "-t", "lab/tasks/robots.yaml")
    assert run(tmp_path, "validate", *files).out == "ok: 1 edge, 3 robots, 9 tasks\n"
    fleet = ("-i", str(ROOT / "inventories" / "local.yaml"), "-t", "lab/tasks/robots.yaml")
    plan = run(tmp_path, "plan", *fleet, "--snapshot", str(SNAPSHOT), "-o", "name")
    assert plan.code == 0, plan.err
    for name in ("roscore", "parameters", "slow_scan-robot3", "camera-robot2", "arm", "merge"):
        assert f"task/{name}\n" in plan.out
    again = run(tmp_path, "import", "ros", str(CORPUS / "robots.launch"), "--out", "lab")
    assert again.code == 64
    assert "lab/inventories/robots.yaml exists" in again.err


def test_without_a_directory_the_task_file_is_printed(tmp_path: Path) -> None:
    said = run(tmp_path, "import", "ros", str(CORPUS / "args.launch"), "rate:=5", "input:=/odom")
    assert said.code == 0
    assert "throttle messages /odom 5 /odom_copy __name:=lazy_throttle" in said.out
    assert said.err == "note: the inventory is written with --out DIR\n"


def test_one_task_per_launch_file(tmp_path: Path) -> None:
    files = [str(CORPUS / name) for name in ("lab_bringup/launch/level3.launch", "minimal.launch.py")]
    said = run(tmp_path, "import", "ros", *files, "robot:=a b", "--group", "file")
    assert "command: roslaunch lab_bringup level3.launch 'robot:=a b'\n" in said.out
    assert f"command: ros2 launch {CORPUS}/minimal.launch.py 'robot:=a b'\n" in said.out
    assert "stop: ros\n" in said.out
    assert "no package holds this file: the hosts need it at the same path" in said.err
    assert "was run here" not in said.err, "the file is not even read"


def test_a_call_without_a_launch_file_is_refused(tmp_path: Path) -> None:
    said = run(tmp_path, "import", "ros", "rate:=5")
    assert (said.code, said.err.splitlines()[0]) == (64, "error: no launch file is named")


def test_what_was_dropped_is_said_where_nothing_is_left(tmp_path: Path) -> None:
    said = run(tmp_path, "import", "ros", str(CORPUS / "nav.launch.py"), "use_composition:=True")
    assert said.code == 64
    assert "the file starts nothing" in said.err
    assert f"{CORPUS}/nav.launch.py:49:1: LoadComposableNodes is not imported" in said.err


def test_a_program_that_others_may_write_is_not_run(tmp_path: Path) -> None:
    file = tmp_path / "x.launch.py"
    file.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n" + (CORPUS / "minimal.launch.py").read_text())
    file.chmod(0o666)
    said = run(tmp_path, "import", "ros", "x.launch.py")
    assert said.code == 64
    assert "error[EC104]: x.launch.py: every user may change it (mode 0666)" in said.err
    assert not (tmp_path / "ran").exists()
    outer = "from launch import LaunchDescription\nfrom launch.actions import IncludeLaunchDescription\n"
    outer += f"def generate_launch_description():\n    return LaunchDescription([IncludeLaunchDescription({str(file)!r})])\n"
    (tmp_path / "y.launch.py").write_text(outer)
    said = run(tmp_path, "import", "ros", "y.launch.py")
    assert said.code == 64
    assert "y.launch.py:4:5: every user may change" in said.err
    assert not (tmp_path / "ran").exists()
    assert run(tmp_path, "import", "ros", "y.launch.py", EDGECTL_INSECURE_FILES="1").code == 0
    assert (tmp_path / "ran").exists()


def test_packages_are_found_by_the_variables_of_ros(tmp_path: Path) -> None:
    said = run(
        tmp_path, "import", "ros", str(CORPUS / "includes.launch"), ROS_PACKAGE_PATH=f"/nowhere:{CORPUS}"
    )
    assert said.code == 0, said.err
    assert "throttle messages /alpha/in 2" in said.out


def test_what_validate_refuses_is_said_at_once(tmp_path: Path) -> None:
    (tmp_path / "token.launch").write_text(
        '<launch><node pkg="a" type="b" name="c"><env name="API_TOKEN" value="x"/></node></launch>\n'
    )
    said = run(tmp_path, "import", "ros", "token.launch")
    assert said.code == 0
    assert "warning[EC018]: tasks/token.yaml:" in said.err


@pytest.fixture
def ssh_config(tmp_path: Path) -> str:
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "lab.conf").write_text(
        "Host jetson-b\n  HostName 10.0.0.8\nHost jetson-*\n  User ubuntu\n"
    )
    (tmp_path / "config").write_text(
        f"Include {tmp_path}/more/*.conf\nHost jetson-a jetson-spare robot1\n  HostName 10.0.0.5\n  Port 2222\nHost *\n  Compression yes\n"
    )
    return str(tmp_path / "config")


def test_hosts_of_the_ssh_config_keep_what_it_says(
    tmp_path: Path, ssh_config: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = run(tmp_path, "import", "ssh", "jetson-?", EDGECTL_SSH_CONFIG=ssh_config)
    assert said.code == 0
    assert said.out.endswith("edges:\n  jetson-b: {host: jetson-b}\n  jetson-a: {host: jetson-a}\n")
    (tmp_path / "lab.yaml").write_text(said.out)
    monkeypatch.setenv("EDGECTL_SSH_CONFIG", ssh_config)
    found = SshConfigResolver().resolve(load_inventory(tmp_path / "lab.yaml").hosts["jetson-b"])
    assert (found.hostname, found.user) == ("10.0.0.8", "ubuntu")


def test_a_pattern_that_matches_no_host_is_refused(tmp_path: Path, ssh_config: str) -> None:
    said = run(tmp_path, "import", "ssh", "jetson-*", "nano-*", EDGECTL_SSH_CONFIG=ssh_config)
    assert said.code == 64
    assert said.err == (
        "error: no host of the ssh_config matches 'nano-*'\nhint: its hosts: jetson-b, jetson-a, jetson-spare, robot1\n"
    )


@pytest.mark.parametrize(("name", "text"), [("hosts.ini", HOSTS_INI), ("hosts.yaml", HOSTS_YAML)])
def test_hosts_of_ansible(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    said = run(tmp_path, "import", "ansible", name)
    assert said.code == 0
    assert said.out[said.out.index("edges:\n") :] == EDGES
    assert f"{name}:" in said.err
    assert "ansible_password is not imported" in said.err
    assert "ansible_host is a template and not imported" in said.err
    assert "secret7" not in said.err + said.out
    (tmp_path / "lab.yaml").write_text(said.out)
    assert list(load_inventory(tmp_path / "lab.yaml").hosts) == [
        "bastion",
        "edge-b",
        "here",
        "jetson01",
        "jetson02",
    ]


def test_a_requirement_file_of_the_paper(tmp_path: Path) -> None:
    (tmp_path / "task_req.yaml").write_text(REQUIREMENTS)
    said = run(tmp_path, "import", "paper", "task_req.yaml", "--out", ".")
    assert said.code == 0
    notes = [line.partition(": ")[2] for line in said.err.splitlines() if line.startswith("warning")]
    assert notes == [
        "task_req.yaml:6:3: R1_SLAM is not in task_seq: it has priority 0",
        "task_req.yaml:8:3: R2_SLAM is not in task_seq: it has priority 0",
        "task_req.yaml:19:21: R2_Navigation needs R1_SLAM, a task of another robot",
        "task_req.yaml:10:3: Map_Merging has no command",
        "task_req.yaml:15:11: the weights new are not imported",
    ]
    _, tasks, _ = load_inventory_and_tasks(
        tmp_path / "inventories" / "task_req.yaml", tmp_path / "tasks" / "task_req.yaml"
    )
    assert {name: task.priority for name, task in tasks.tasks.items()} == {
        "r1_slam": 0, "r1_navigation": 2, "r2_slam": 0, "r2_navigation": 3, "map_merging": 1}  # fmt: skip
    merging = tasks.tasks["map_merging"]
    assert (merging.robots, [need.task for need in merging.needs]) == (("r1", "r2"), ["r1_slam", "r2_slam"])
    navigation = tasks.tasks["r1_navigation"]
    assert navigation.command == "roslaunch edge_robot nav_1.launch"
    cpu = navigation.demand["cpu"]
    assert cpu is not None
    assert cpu.value == pytest.approx(0.02705)
    assert navigation.stop.preset == "ros"
