# SPDX-License-Identifier: Apache-2.0
"""The launch files of the tests, imported and applied on real graphs: their nodes are up, with the right names, arguments,
environments, remaps and parameters, as the graph, the kernel and the parameter servers say.

Some of them, and all of them with ROS_LAUNCH=all. The programs are nodes of the tests in packages of their own; with ROS 2
also the command ``ros2``, which is not among the packages of rclpy.
"""

import contextlib
import json
import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xmlrpc.client import ServerProxy

import pytest

from edgectl.cli.user_files import refuse_exposed_files
from edgectl.importers.launch_values import PACKAGE_MARK, Launch, RosNode, join_names
from edgectl.importers.ros_parameters import flatten_parameters
from edgectl.usecases.import_files import read_launch_files
from tests.cli.fleet_dir import enter_fleet
from tests.cli.inprocess import edgectl
from tests.e2e.test_unreachable import wait_until
from tests.importers.test_launch_files import ARGUMENTS, CORPUS, LAUNCH_FILES, import_from_corpus
from tests.pace import patience
from tests.ros.test_gateway import find_free_port
from tests.ros.test_ros2 import PYTHON

SHORT = ("params.launch", "full.launch.yaml")
CHOSEN = LAUNCH_FILES if os.environ.get("ROS_LAUNCH") == "all" else SHORT
NODES = {1: Path(__file__).with_name("lab_node1.py"), 2: Path(__file__).with_name("lab_node2.py")}
PYTHONS = {1: "/usr/bin/python3", 2: str(PYTHON)}
# Names to which each node subscribes; remaps of the files are of these.
NAMES = {1: ("chatter", "scan", "~input"), 2: ("chatter", "scan", "input", "cmd_vel", "/tf")}
# What packages hold that the files take parameters from.
PARAMETERS = {1: "from_file: 7\n", 2: "/**:\n  ros__parameters:\n    from_file: 7\n"}
OWN_PARAMETERS = {"start_type_description_service", "use_sim_time"}
ROS2 = """#!{python} -S
import os, sys, time
words = sys.argv[1:]
if words[:1] == ["run"]:
    prefix = words[2].split() if words[1] == "--prefix" else []
    package, name, *more = words[3 if prefix else 1:]
    argv = [*prefix, sys.executable, f"{workspace}/{{package}}/{{name}}", *more]
    os.execvp(argv[0], argv)
elif words[:2] == ["pkg", "prefix"]:
    print(f"{workspace}/{{words[-1]}}")
else:
    time.sleep(1000)
"""


@dataclass(frozen=True, kw_only=True)
class Lab:
    """A workspace with every package that a launch file names, and the graph of its own."""

    version: int
    workspace: Path
    port: int
    domain: int

    @property
    def master(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def ros(self) -> str:
        graph = f'master: "{self.master}"' if self.version == 1 else f"domain: {self.domain}"
        return f"{{version: {self.version}, {graph}, setup: [{self.workspace}/setup.bash]}}"

    def expand(self, value: Any) -> Any:
        """A value with the directories of packages as the hosts have them."""
        if isinstance(value, str):
            return PACKAGE_MARK.sub(lambda found: f"{self.workspace}/{found[2]}", value)
        return value


def make_lab(folder: Path, launch: Launch) -> Lab:
    version = launch.nodes[0].version
    lab = Lab(
        version=version, workspace=folder / "ws", port=find_free_port(), domain=1 + (os.getpid() + 50) % 200
    )
    shutil.copytree(CORPUS / "lab_bringup", lab.workspace / "lab_bringup")
    if version == 2:
        (lab.workspace / "lab_bringup" / "config" / "gains.yaml").write_text(PARAMETERS[2])
    for file in (
        "elsewhere/config/more.yaml",
        "elsewhere/share/more.yaml",
        "nav2_bringup/params/nav2_params.yaml",
    ):
        path = lab.workspace / file
        path.parent.mkdir(parents=True)
        path.write_text(PARAMETERS[version])
    for node in launch.nodes:
        if node.package:
            make_program(lab, node)
    for package in lab.workspace.iterdir():
        (package / "package.xml").write_text(
            f'<package format="2"><name>{package.name}</name><version>1.0.0</version></package>'
        )
    programs = lab.workspace.with_name("bin")
    programs.mkdir()
    (programs / "ros2").write_text(ROS2.format(python=PYTHON, workspace=lab.workspace))
    (programs / "ros2").chmod(0o755)
    search = f"{programs}:{PYTHON.parent}:$PATH" if version == 2 else "/usr/bin:$PATH"
    (lab.workspace / "setup.bash").write_text(
        f"export PATH={search} LAB_NAMES='{' '.join(NAMES[version])}'\n"
        f"export ROS_PACKAGE_PATH={lab.workspace}:/usr/share ROS_LOG_DIR={lab.workspace}/log\n"
    )
    return lab


def make_program(lab: Lab, node: RosNode) -> None:
    program = lab.workspace / node.package / node.executable
    if not program.exists():
        program.parent.mkdir(exist_ok=True)
        program.write_text(f"#!{PYTHONS[lab.version]}\n" + NODES[lab.version].read_text())
        program.chmod(0o755)


def put_on_this_machine(inventory: str, lab: Lab) -> str:
    """The inventory with this machine as every host, and the graph of the test."""
    lines = []
    for line in inventory.splitlines():
        if found := re.fullmatch(r"  ([\w.-]+): \{.*\}", line):
            onboard = "onboard: true" if "onboard: true" in line else ""
            robot = "probe: false" if "probe: false" in line else onboard
            rest = ", ".join(part for part in ("connection: local", "host: 127.0.0.1", robot) if part)
            line = f"  {found[1]}: {{{rest}}}"  # noqa: PLW2901
        lines.append(re.sub(r"\{version: [12].*?\}", lambda _: lab.ros, line) if "defaults" in line else line)
    return "\n".join(lines) + "\n"


def read_launch(name: str, monkeypatch: pytest.MonkeyPatch) -> Launch:
    monkeypatch.setenv("LAB_TOPIC", "/chatter")
    monkeypatch.delenv("LAB_OUT", raising=False)
    monkeypatch.chdir(CORPUS)
    return read_launch_files(
        [name], ARGUMENTS.get(name, {}), ["."], by_file=False, refuse_exposed=refuse_exposed_files
    )


def get_full_name(node: RosNode) -> str:
    return node.full_name if node.name else join_names(node.namespace, node.executable)


def list_expected_topics(node: RosNode) -> set[str]:
    """Where the fixed names lead, with the remaps of the node."""
    full = get_full_name(node)

    def resolve(name: str) -> str:
        return f"{full}/{name[1:].lstrip('/')}" if name.startswith("~") else join_names(node.namespace, name)

    remaps: dict[str, str] = {}
    for name, target in node.remaps:
        remaps.setdefault(resolve(name), resolve(target))
    return {remaps.get(resolve(name), resolve(name)) for name in NAMES[node.version]}


def check_process(pid: int, node: RosNode, lab: Lab) -> None:
    """Arguments and environment, as the kernel has them."""
    argv = Path(f"/proc/{pid}/cmdline").read_text().split("\0")
    program = str(lab.workspace / node.package / node.executable)
    begin = argv.index(program) + 1
    assert argv[begin : begin + len(node.arguments)] == [lab.expand(each) for each in node.arguments]
    environ = dict(
        entry.partition("=")[::2] for entry in Path(f"/proc/{pid}/environ").read_text().split("\0")
    )
    assert {name: environ.get(name) for name in node.env} == {
        name: lab.expand(value) for name, value in node.env.items()
    }


def call(uri: str, method: str, *words: str) -> Any:
    """What a method of the ROS APIs returns."""
    with ServerProxy(uri) as proxy:
        code, message, value = getattr(proxy, method)("/test", *words)
    assert code == 1, message
    return value


def check_ros1(launch: Launch, lab: Lab) -> None:
    """Nodes as the master and their own APIs have them, and all parameters."""

    def list_subscribers() -> list[tuple[str, list[str]]]:
        return list(call(lab.master, "getSystemState")[1])

    def are_up() -> bool:
        """Each node has registered all of its names, one after the other."""
        pairs = {(name, topic) for topic, names in list_subscribers() for name in names}
        return all(
            (node.full_name, topic) in pairs for node in launch.nodes for topic in list_expected_topics(node)
        )

    with contextlib.suppress(AssertionError):  # what is missing is said below
        wait_until(are_up, 30.0)
    state = list_subscribers()
    for node in launch.nodes:
        heard = {topic for topic, names in state if node.full_name in names}
        assert heard == list_expected_topics(node), node.full_name
        check_process(int(call(call(lab.master, "lookupNode", node.full_name), "getPid")), node, lab)
    expected = {
        f"{node.full_name}/{name}": value for node in launch.nodes for name, value in node.parameters.items()
    }
    expected |= {f"{where}/from_file": 7 for node in launch.nodes for _, where in node.parameter_files}
    expected |= launch.parameters
    found = flatten_parameters({f"/{key}": value for key, value in call(lab.master, "getParam", "/").items()})
    computed = {
        *launch.computed,
        *(f"{node.full_name}/{name}" for node in launch.nodes for name in node.computed),
    }
    assert computed <= set(found)
    own = {name for name in found if name in computed or name.startswith(("/ros", "/run_id"))}
    assert {name: value for name, value in found.items() if name not in own} == {
        name: lab.expand(value) for name, value in flatten_parameters(expected).items()
    }


def ask_ros2(names: list[str], lab: Lab) -> Mapping[str, tuple[list[str], dict[str, Any]]]:
    seconds = patience(40.0)
    done = subprocess.run(
        [str(PYTHON), str(NODES[2]), "ask", str(seconds), *names],
        env={**os.environ, "ROS_DOMAIN_ID": str(lab.domain)},
        capture_output=True,
        text=True,
        check=False,
        timeout=2 * seconds,
    )
    assert done.returncode == 0, done.stderr
    found: Mapping[str, tuple[list[str], dict[str, Any]]] = json.loads(done.stdout)
    return found


def check_ros2(launch: Launch, lab: Lab) -> None:
    """Nodes as the graph and their own parameter services have them."""
    nodes = [node for node in launch.nodes if node.package]
    found = ask_ros2([get_full_name(node) for node in nodes], lab) if nodes else {}
    for node in nodes:
        topics, parameters = found[get_full_name(node)]
        assert set(topics) - {"/parameter_events", "/clock"} == list_expected_topics(node), node.full_name
        expected = {
            name: lab.expand(value)
            for name, value in flatten_parameters(node.parameters, separator=".").items()
        }
        expected |= {"from_file": 7} if node.parameter_files else {}
        own = OWN_PARAMETERS - set(expected)
        assert {name: value for name, value in parameters.items() if name not in own} == expected


def apply_everything(folder: Path) -> None:
    """Apply, and again once jobs have completed: what waits for them is placed by the next plan."""

    def is_complete() -> bool:
        applied = edgectl(["apply", "--yes"], folder, dict(os.environ))
        waits = "has not completed yet" in applied.out
        assert applied.code == 0 or waits, applied
        return not waits

    wait_until(is_complete, 30.0)


@pytest.mark.parametrize("name", CHOSEN)
def test_what_is_imported_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    launch = read_launch(name, monkeypatch)
    lab = make_lab(tmp_path, launch)
    made = import_from_corpus(name)
    tasks = made.tasks.replace("command: roscore", f"command: roscore -p {lab.port}")
    # A program that ends by itself: the launch file does not say that it does.
    tasks = tasks.replace("command: echo afalse", "command: echo afalse\n    kind: job")
    inventory = put_on_this_machine(made.inventory, lab)
    with enter_fleet(tmp_path, inventory, tasks, monkeypatch) as folder:
        planned = edgectl(["plan"], folder, dict(os.environ))
        assert planned.code == 0, planned
        apply_everything(folder)
        (check_ros1 if lab.version == 1 else check_ros2)(launch, lab)
