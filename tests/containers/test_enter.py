# SPDX-License-Identifier: Apache-2.0
"""``edgectl exec`` in a container: the command line, with arguments that no shell sees."""

import shlex
from dataclasses import replace

from edgectl.model.inventory import Connection
from edgectl.transport.shell_command import build_container_command
from tests.builders import an_edge


def test_the_command_line_on_this_machine_and_over_ssh() -> None:
    words = ["sh", "-c", "echo '$HOME' && true"]
    here = build_container_command(
        replace(an_edge("edge2"), connection=Connection.LOCAL),
        "docker",
        "edgectl-lab-edge1-slam",
        words,
        tty=True,
    )
    assert here == ["docker", "exec", "--interactive", "--tty", "edgectl-lab-edge1-slam", *words]
    *ssh, remote = build_container_command(an_edge("edge1"), "podman", "edgectl-lab-edge1-slam", words)
    assert ssh[0] == "ssh"
    assert shlex.split(remote) == [
        "exec",
        "podman",
        "exec",
        "--interactive",
        "edgectl-lab-edge1-slam",
        *words,
    ]
