# SPDX-License-Identifier: Apache-2.0
"""UDP has no byte counters: probes and profilers say where there is some, on real sockets of this machine."""

import contextlib
import os
import socket
import sys
from collections.abc import Iterator

import pytest

from edgectl.agent.measure import proc, udp
from tests.agent.conftest import AgentHost, Profiled, eventually
from tests.agent.test_probe import build_links, has_v6

UNSEEN = "udp unseen"
LINKS = build_links(61)
ROBOT = LINKS[0]["address"]
# A port as DDS has them, below those that the kernel gives away.
CHOSEN = 20000 + os.getpid() % 10000
# A task that opens a socket, sends nothing, and stays.
_HOLD = "import socket, time; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); {act}; time.sleep(600)"


@contextlib.contextmanager
def bound(address: str, port: int = 0, family: int = socket.AF_INET) -> Iterator[socket.socket]:
    with socket.socket(family, socket.SOCK_DGRAM) as made:
        made.bind((address, port))
        yield made


def find_remote(made: socket.socket, *, busy: bool) -> str | None:
    """Where the traffic of a socket goes, as ``find_sockets``; None: it is not among them."""
    return udp.find_sockets(busy).get(os.fstat(made.fileno()).st_ino)


@pytest.mark.parametrize(
    ("address", "port", "idle", "busy"),
    [("0.0.0.0", CHOSEN, "", ""), ("0.0.0.0", 0, None, ""), ("127.0.0.1", CHOSEN, None, None)],
    ids=["a port of its choice", "any port, as roscpp has one unused", "this machine only"],
)
def test_a_socket_without_a_peer_counts_where_it_may_send(
    address: str, port: int, idle: str | None, busy: str | None
) -> None:
    with bound(address, port) as made:
        assert (find_remote(made, busy=False), find_remote(made, busy=True)) == (idle, busy)


def test_a_connected_socket_counts_for_its_peer() -> None:
    with bound("127.0.0.1") as made:
        made.connect((ROBOT, 9))
        assert find_remote(made, busy=False) == ROBOT


@pytest.mark.skipif(not has_v6(), reason="this machine has no IPv6")
def test_addresses_of_ipv6_are_read_and_mapped_ones_are_ipv4() -> None:
    with bound("::", family=socket.AF_INET6) as made:
        made.connect(("::ffff:" + ROBOT, 9))
        assert find_remote(made, busy=False) == ROBOT
    with bound("::1", family=socket.AF_INET6) as made:
        assert find_remote(made, busy=True) is None
        made.connect(("::1", 9))
        assert find_remote(made, busy=False) == "::1"


def test_sockets_on_any_port_count_while_datagrams_pass() -> None:
    meter = udp.UdpMeter(proc.read_network_counters())
    with bound("0.0.0.0") as made, bound("127.0.0.1") as peer:
        for _ in range(2000):
            made.sendto(b"x", peer.getsockname())
        assert meter.find_sockets(proc.read_network_counters())[os.fstat(made.fileno()).st_ino] == ""


def test_a_probe_says_which_links_and_tasks_are_partly_seen(host: AgentHost) -> None:
    acts = {
        "camera": f"s.connect(({ROBOT!r}, 9))",
        "slam": f"s.bind(('0.0.0.0', {CHOSEN}))",
        "clock": "s.connect(('127.0.0.9', 9))",
    }
    for task, act in acts.items():
        host.start(task, f'exec {sys.executable} -I -S -c "{_HOLD.format(act=act)}"')

    def seen() -> dict[str, str] | None:
        found = host.ask("probe", window_s=0.05, links=LINKS)
        gaps = {name: each["partial"] for kind in ("links", "tasks") for name, each in found[kind].items()}
        return gaps if gaps["camera"] and gaps["slam"] else None

    gaps = eventually(seen)
    assert gaps == {"robot1": UNSEEN, "robot2": "", "camera": UNSEEN, "slam": UNSEEN, "clock": ""}


def test_a_profiler_says_it_of_young_and_of_known_tasks(profiled: Profiled) -> None:
    profiled.start(every=0.5, links=LINKS)
    act = f"s.connect(({ROBOT!r}, 9))"
    profiled.host.start("camera", f'exec {sys.executable} -I -S -c "{_HOLD.format(act=act)}"')

    def seen() -> bool:
        found = profiled.probe(links=LINKS)
        gaps = found["links"]["robot1"]["partial"], found["tasks"]["camera"]["partial"]
        return gaps == (UNSEEN, UNSEEN) and found["links"]["robot2"]["partial"] == ""

    eventually(seen)
