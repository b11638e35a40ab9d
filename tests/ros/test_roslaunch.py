# SPDX-License-Identifier: Apache-2.0
"""Compare the reader of ROS 1 launch files with roslaunch itself, on the corpus and on random files.

Needs Debian's python3-roslaunch, so ``make ros`` runs it.
"""

import json
import os
import shlex
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from edgectl.cli.user_files import refuse_exposed_files
from edgectl.errors import InputError
from edgectl.importers.launch_values import PACKAGE_MARK, Launch
from edgectl.importers.ros_parameters import flatten_parameters
from edgectl.usecases.import_files import read_launch_files
from tests.importers.random_launch import write_random_launch_files
from tests.importers.test_launch_files import ARGUMENTS, CORPUS, LAUNCH_FILES

READER = Path(__file__).parent / "roslaunch_reader.py"
PACKAGE = str(CORPUS / "lab_bringup")
# Files with what only one side can have: a package that is not here, a name that roslaunch draws at random.
APART = {"rosparam.launch", "env.launch", "params.launch"}


def ask_roslaunch(specs: Sequence[str]) -> list[dict[str, Any]]:
    """What roslaunch reads from each ``FILE[,ARG:=VALUE..]``."""
    done = subprocess.run(
        ["/usr/bin/python3", str(READER), *specs],
        env={**os.environ, "ROS_PACKAGE_PATH": str(CORPUS), "LAB_TOPIC": "/chatter"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, f"is python3-roslaunch installed? {done.stderr[-500:]}"
    return [json.loads(line) for line in done.stdout.splitlines()]


def expand(value: Any) -> Any:
    """A value with the marks of packages replaced by their directories here."""
    if isinstance(value, str):
        return PACKAGE_MARK.sub(PACKAGE, value)
    if isinstance(value, Mapping):
        return {key: expand(each) for key, each in value.items()}
    return [expand(each) for each in value] if isinstance(value, list | tuple) else value


def describe_launch(launch: Launch) -> dict[str, Any]:
    """Our side, in the form of the reader's."""
    private = {
        f"{node.full_name}/{name}": value for node in launch.nodes for name, value in node.parameters.items()
    }
    described: dict[str, Any] = expand({
        "nodes": [
            {
                "name": node.full_name,
                "package": node.package,
                "executable": node.executable,
                "arguments": node.arguments,
                "remaps": node.remaps,
                "env": node.env,
                "machine": node.machine,
                "respawn": bool(node.respawn),
                "prefix": node.prefix,
            }
            for node in launch.nodes
        ],
        "parameters": {**launch.parameters, **private},
        "machines": {
            name: [machine.address, machine.user, machine.port or 22] for name, machine in launch.machines.items()
        },
    })  # fmt: skip
    return described


def normalise(record: dict[str, Any]) -> dict[str, Any]:
    """Theirs, with arguments as words and nested parameters by their full names."""
    nodes = [{**node, "arguments": shlex.split(node["arguments"])} for node in record["nodes"]]
    return {
        **record,
        "nodes": nodes,
        "parameters": flatten_parameters(record["parameters"]),
    }


@pytest.mark.parametrize(
    "name", [name for name in LAUNCH_FILES if name.endswith(".launch") and name not in APART]
)
def test_the_corpus_reads_the_same(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LAB_TOPIC", "/chatter")
    given = ARGUMENTS.get(name, {})
    path = str(CORPUS / name)
    [theirs] = ask_roslaunch([",".join([path, *(f"{key}:={value}" for key, value in given.items())])])
    ours = describe_launch(
        read_launch_files([path], given, [str(CORPUS)], by_file=False, refuse_exposed=refuse_exposed_files)
    )
    assert ours == normalise(theirs)


def read_or_refuse(path: Path) -> dict[str, Any]:
    """Our side, or our error."""
    try:
        return describe_launch(
            read_launch_files(
                [str(path)], {}, [str(CORPUS)], by_file=False, refuse_exposed=refuse_exposed_files
            )
        )
    except InputError as error:
        return {"error": str(error)}


@pytest.mark.parametrize("seed", [1, 1000, 2000])
def test_random_files_read_the_same(seed: int, tmp_path: Path) -> None:
    paths = write_random_launch_files(tmp_path, 150, seed)
    valid = 0
    for path, theirs in zip(paths, ask_roslaunch([str(path) for path in paths]), strict=True):
        ours = read_or_refuse(path)
        assert ("error" in ours) == ("error" in theirs), (path.read_text(), ours, theirs)
        if "error" not in ours:
            assert ours == normalise(theirs), path.read_text()
            valid += 1
    assert valid > 75
