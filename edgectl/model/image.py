# SPDX-License-Identifier: Apache-2.0
"""The container in which a task runs: its image, and what of the host it may use."""

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum

from edgectl.dataclass import dataclass


class ContainerEngine(StrEnum):
    """What runs containers on a host: a program, or the Docker Swarm of which it is a node (ADR 171)."""

    DOCKER = "docker"
    PODMAN = "podman"
    SWARM = "swarm"


class PullPolicy(StrEnum):
    """When the image is fetched, before anything that runs is stopped."""

    MISSING = "missing"
    ALWAYS = "always"
    NEVER = "never"


@dataclass(frozen=True, slots=True, kw_only=True)
class ContainerImage:
    """The container of a task: ``name`` is the reference of its image.

    ``engine`` None: the first one that its host has. ``gpus``: ``all``, or how many. ``devices`` and
    ``volumes`` are written as the engine takes them (``HOST:CONTAINER:OPTIONS``). ``env`` comes on top of the
    environment of host and task. ``network`` and ``ipc`` are those of the host by default, as ROS 2 needs
    both. ``args``: further options of ``docker create``.
    """

    name: str
    engine: ContainerEngine | None = None
    gpus: str | None = None
    devices: tuple[str, ...] = ()
    volumes: tuple[str, ...] = ()
    env: Mapping[str, str] = field(default_factory=dict)
    user: str | None = None
    network: str = "host"
    ipc: str = "host"
    pull: PullPolicy = PullPolicy.MISSING
    args: tuple[str, ...] = ()
