# SPDX-License-Identifier: Apache-2.0
"""A real Docker Swarm of several engines, each with a network of its own, joined by a bridge of the tests."""

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from tests.containers.conftest import ContainerHost
from tests.containers.docker_engine import DockerEngine
from tests.faults.network import ManagerNetwork, plug_in_card, run_ip

CONTEXT = "managers"
"""The name by which every host reaches the first manager."""
# A node that is away for three of these is down: where that is tested, and where a busy machine must not pass for it.
SHORT_HEARTBEAT, LONG_HEARTBEAT = "2s", "30s"


@dataclass
class SwarmNode:
    """One engine on the bridge. ``cable``: its end there."""

    engine: DockerEngine
    site: ManagerNetwork
    number: int

    @property
    def address(self) -> str:
        return f"{self.site.network}.{self.number}"

    @property
    def cable(self) -> str:
        return f"v-{self.number}"

    @property
    def holder(self) -> int:
        assert self.engine.holder is not None
        return self.engine.holder.pid

    def plug_in(self) -> None:
        """Give the engine's network a card, at the bridge."""
        plug_in_card(self.cable, site=self.site.process.pid, inside=self.holder, address=self.address)

    def drop_packets(self) -> None:
        run_ip("link", "set", self.cable, "nomaster", netns=self.site.process.pid)

    def pass_packets(self) -> None:
        run_ip("link", "set", self.cable, "master", "br0", netns=self.site.process.pid)

    @property
    def node_id(self) -> str:
        return str(json.loads(self.engine.call("info", "--format", "{{json .Swarm}}"))["NodeID"])

    def list_running(self) -> list[str]:
        return self.engine.list_containers(dead=False)


@dataclass
class Swarm:
    """Its nodes by name; the first ones are managers."""

    nodes: dict[str, SwarmNode] = field(default_factory=dict)
    managers: int = 1

    @property
    def manager(self) -> DockerEngine:
        return next(iter(self.nodes.values())).engine

    def form(self, heartbeat: str) -> None:
        """Make one swarm of all engines."""
        first, *others = self.nodes.values()
        place = ["--advertise-addr", first.address, "--listen-addr", f"{first.address}:2377"]
        first.engine.call("swarm", "init", *place, "--dispatcher-heartbeat", heartbeat)
        for number, node in enumerate(others, start=1):
            role = "manager" if number < self.managers else "worker"
            token = first.engine.call("swarm", "join-token", "--quiet", role)
            place = ["--advertise-addr", node.address, "--listen-addr", f"{node.address}:2377"]
            node.engine.call("swarm", "join", "--token", token, *place, f"{first.address}:2377")

    def list_services(self) -> list[str]:
        return self.manager.call("service", "ls", "--format", "{{.Name}}").split()

    def get_state(self, name: str) -> str:
        """Whether the managers take a node as ``ready`` or ``down``."""
        node = self.nodes[name].node_id
        return self.manager.call("node", "inspect", "--format", "{{.Status.State}}", node)

    def add_context(self, node: SwarmNode) -> None:
        """Let the host of ``node`` reach the first manager, as its user would: by a context of docker."""
        node.engine.call("context", "create", CONTEXT, "--docker", f"host=unix://{self.manager.socket}")


@contextmanager
def swarm_of(
    folder: Path, names: Sequence[str], *, managers: int = 1, heartbeat: str = LONG_HEARTBEAT
) -> Iterator[Swarm]:
    """A swarm of these nodes, with the image of the tests on each."""
    with ExitStack() as stack:
        site = ManagerNetwork.make("10.232.0")
        stack.callback(site.close)
        swarm = Swarm(managers=managers)
        for number, name in enumerate(names, start=11):
            engine = DockerEngine(folder / name, live_restore=False)
            stack.callback(engine.end)
            engine.start()
            swarm.nodes[name] = SwarmNode(engine, site, number)
            swarm.nodes[name].plug_in()
            engine.import_image()
        swarm.form(heartbeat)
        for node in list(swarm.nodes.values())[1:]:
            swarm.add_context(node)
        yield swarm


class SwarmHost(ContainerHost):
    """A host whose tasks are services of a swarm, on its own engine."""

    def __init__(self, name: str, state: Path, node: SwarmNode, contexts: Sequence[str] = ()) -> None:
        super().__init__(name, state)
        self.stated: dict[str, object] = {"engine": "swarm", "managers": list(contexts)}
        words = " ".join(f"{key}='{text}'" for key, text in node.engine.environment.items())
        python = state.parent / f"python-{name}"
        python.write_text(f'#!/bin/sh\nexec env {words} {sys.executable} "$@"\n')
        python.chmod(0o755)
        self.session.python = str(python)
        self.node = node
