# SPDX-License-Identifier: Apache-2.0
"""The command line of a service: its name, what it may do, and texts that a swarm would read as templates."""

import csv
import re
from itertools import pairwise
from typing import Any

import pytest

from edgectl.agent.containers import create, service
from tests.agent.conftest import a_spec
from tests.containers.conftest import an_image

IDENTITY = {"fleet": "lab", "host": "zeta", "task": "slam", "instance": "i7"}
IMAGE_ID = "sha256:" + "ab" * 32


def build(spec: dict[str, Any], **variables: str) -> list[str]:
    return service.build_service_words(
        "edgectl-lab-zeta-slam", "n0de", IMAGE_ID, spec, IDENTITY, "/state/slam", variables
    )


def find_options(words: list[str], option: str) -> list[str]:
    return [value for name, value in pairwise(words) if name == option]


def test_one_container_on_one_node_that_nobody_starts_again() -> None:
    words = build(a_spec("run slam", image=an_image(args=["--ulimit=rtprio=99"])))
    assert words[:2] == ["service", "create"]
    assert find_options(words, "--constraint") == ["node.id==n0de"]
    assert (find_options(words, "--mode"), find_options(words, "--replicas")) == (["replicated"], ["1"])
    assert find_options(words, "--restart-condition") == ["none"]
    assert {"--no-healthcheck", "--init", "--no-resolve-image", "--ulimit=rtprio=99"} <= set(words)
    for option in ("--label", "--container-label"):
        assert find_options(words, option) == [
            "edgectl.dir=/state/slam", "edgectl.fleet=lab", "edgectl.host=zeta", "edgectl.instance=i7",
            "edgectl.place=n0de:/state/slam", "edgectl.task=slam",
        ]  # fmt: skip
    assert words[-4:-1] == [IMAGE_ID, "/bin/sh", "-c"]
    assert words[-1].endswith("run slam")
    assert build(a_spec("", image=an_image()))[-1] == IMAGE_ID


def test_volumes_and_shared_memory_are_mounts() -> None:
    volumes = ["/srv/a,b:/maps:ro", "NAME:/data", "/x/{{y}}:/y:rw"]
    found = find_options(build(a_spec("x", image=an_image(volumes=volumes))), "--mount")
    assert [next(csv.reader([each])) for each in found] == [
        ["type=bind", "source=/srv/a,b", "target=/maps", "readonly"],
        ["type=volume", "source=NAME", "target=/data"],
        ["type=bind", 'source=/x/{{"{{"}}y}}', "target=/y"],
        ["type=bind", "source=/dev/shm", "target=/dev/shm"],
    ]
    alone = build(a_spec("x", image=an_image(volumes=[], ipc="private")))
    assert find_options(alone, "--mount") == []


def test_limits_user_and_directory() -> None:
    image = an_image(user="1000:1000", workdir="/tmp")
    words = build(a_spec("x", image=image, limits={"cpu": 0.5, "memory": 1 << 20}))
    assert [find_options(words, f"--{name}") for name in ("user", "workdir", "limit-cpu", "limit-memory")] == [
        ["1000:1000"], ["/tmp"], ["0.50"], ["1048576b"],
    ]  # fmt: skip


def test_values_are_on_no_command_line_and_no_templates() -> None:
    stated = {"KEY": "canary {{.Node.ID}} }}", create.NAME_VARIABLE: "as of a container"}
    variables = service.build_service_variables(stated)
    # Go fills in {{"{{"}} as {{ and leaves }} as it is.
    assert variables["KEY"].replace('{{"{{"}}', "{{") == stated["KEY"]
    assert "{{." not in variables["KEY"]
    assert variables[create.NAME_VARIABLE] == "{{.Task.Name}}"
    words = build(a_spec("x", image=an_image()), **variables)
    assert find_options(words, "--env") == [create.NAME_VARIABLE, "KEY"]
    assert not any("canary" in word for word in words)


@pytest.mark.parametrize(
    "names",
    [
        ("lab", "edge1", "slam"),
        ("lab", "jetson.b", "slam"),
        ("lab-3f2a9c", "e" * 40, "robot1-slam"),
        ("lab", "e" * 40, "robot2-slam"),
        ("lab", "edge1", "slam-"),
        ("lab", "edge1", "slam_"),
        ("lab", "edge1", "slam"[:1] * 63),
        ("lab", "jetson-b", "slam"),
    ],
)
def test_a_name_that_a_swarm_takes(names: tuple[str, str, str]) -> None:
    name = service.build_service_name(*names)
    assert re.fullmatch(r"[a-zA-Z0-9]+(?:[-_]*[A-Za-z0-9]+)*", name)
    assert len(name) <= 63
    assert name.startswith("edgectl-lab")


def test_different_tasks_have_different_names() -> None:
    names = [
        ("lab", "a.b", "c"),
        ("lab", "a-b", "c"),
        ("lab", "a", "b-c-"),
        ("lab", "x" * 60, "y"),
        ("lab", "x" * 60, "z"),
    ]
    found = [service.build_service_name(*each) for each in names]
    assert len(set(found)) == len(names)
    assert found[1] == "edgectl-lab-a-b-c"
