# SPDX-License-Identifier: Apache-2.0
"""An engine for all tests of a file, and a host whose agent finds it."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from tests.agent.conftest import AgentHost, a_spec
from tests.containers.docker_engine import (
    IMAGE,
    SYSTEM,
    DockerEngine,
    docker_engine,
    find_missing_for_containers,
)


class ContainerHost(AgentHost):
    """A host whose tasks run in containers. ``stated``: keys of every image."""

    stated: Mapping[str, object] = {}

    def start(
        self, task: str, command: str, *, instance: str = "i1", generation: int = 1, **spec: object
    ) -> dict[str, object]:
        """Start ``command`` in the image of the tests; keys of the image are stated in ``image``."""
        stated = {"restart": "on-failure", **spec, "image": self.build_image(spec.pop("image", None))}
        return self.ask(
            "start",
            task=task,
            instance=instance,
            generation=generation,
            spec=a_spec(command, **stated),
            timeout=120.0,
        )

    def build_image(self, more: object = None) -> dict[str, object]:
        """The image of a spec, with ``more`` keys."""
        return an_image(**{**self.stated, **dict(more or {})})  # type: ignore[call-overload]


def an_image(**stated: object) -> dict[str, object]:
    image: dict[str, object] = {
        "name": IMAGE, "engine": "docker", "gpus": None, "devices": [], "volumes": list(SYSTEM), "user": None,
        "network": "host", "ipc": "host", "pull": "missing", "args": [], "workdir": None,
        "managers": [],
    }  # fmt: skip
    return image | stated


@pytest.fixture(scope="session")
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DockerEngine]:
    """An engine that all tests share which leave it as it is."""
    assert not (lacking := find_missing_for_containers()), lacking
    with docker_engine(tmp_path_factory.mktemp("docker")) as found:
        yield found


@pytest.fixture
def host(engine: DockerEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ContainerHost]:
    """One host of this engine, with an empty state directory."""
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "state"))
    for name, value in engine.environment.items():
        monkeypatch.setenv(name, value)
    agent = ContainerHost("edge1", tmp_path / "state")
    yield agent
    agent.end()
    left = engine.list_containers()
    if left:
        engine.call("rm", "--force", *left)
    assert left == []
