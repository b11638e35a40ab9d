# SPDX-License-Identifier: Apache-2.0
"""Live capacity of links over real sockets on a shaped cable: passive readings, probes of idle links, and their bounds."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.snapshot import CapacitySource, LinkSample
from edgectl.state.link_readings import load_link_histories
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.probe import probe_fleet
from edgectl.usecases.record import list_events_after
from tests.agent.conftest import eventually
from tests.builders import a_robot, an_edge, an_inventory, some_tasks
from tests.usecases.shaped_network import ShapedNetwork, find_missing, make_shaped_network

pytestmark = pytest.mark.skipif(bool(find_missing()), reason=find_missing() or "here")
MBIT = 125000.0
DECLARED = 50 * MBIT


@pytest.fixture(scope="module")
def network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ShapedNetwork]:
    with make_shaped_network(tmp_path_factory.mktemp("shaped")) as made:
        yield made


class Site:
    """A fleet on the cable; each probe is ten seconds after the one before."""

    def __init__(self, network: ShapedNetwork, folder: Path, *, probe_links: bool = True) -> None:
        self.now = 1000.0
        folder.mkdir()
        inventory = an_inventory(
            an_edge("edge1"),
            a_robot("robot1"),
            links={("edge1", "robot1"): DECLARED},
            probe_links=probe_links,
        )
        self.fleet = Fleet(
            inventory=inventory,
            tasks=some_tasks(),
            transport=network,
            state=folder,
            clock=lambda: self.now,
        )

    def probe(self, window: float = 0.1) -> LinkSample:
        self.now += 10.0
        snapshot = probe_fleet(self.fleet, ProbeOptions(window=window, probe_idle_links=True))
        return snapshot.hosts["edge1"].links["robot1"]

    @property
    def answered(self) -> bool:
        return any(each.answered for each in load_link_histories(self.fleet.state).values())

    @property
    def sampled_at(self) -> float:
        return max((each.sampled_at for each in load_link_histories(self.fleet.state).values()), default=0.0)


@pytest.fixture
def site(network: ShapedNetwork, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "hosts"))
    return Site(network, tmp_path / "state")


def is_near(link: LinkSample, mbit: float) -> bool:
    """Within 15 % of what the shaper lets pass, of which headers take 4.4 %."""
    return abs(link.capacity_bytes_per_s / (0.956 * mbit * MBIT) - 1) <= 0.15


@pytest.mark.parametrize("by", ["tbf", "htb"])
def test_an_idle_link_is_probed_and_a_change_is_followed_within_three_probes(
    network: ShapedNetwork, site: Site, by: str
) -> None:
    for mbit in (20, 4, 12):
        network.shape(mbit, by)
        before = network.count_received("robot1")
        found = [site.probe()]
        while not is_near(found[-1], mbit):
            assert len(found) < 3, [link.capacity_bytes_per_s / MBIT for link in found]
            found.append(site.probe())
        assert found[-1].capacity_source is CapacitySource.PROBE
        assert (found[-1].capacity_age_s, found[-1].nominal) == (0.0, DECLARED)
        # 0.09 s at the declared rate at most, with headers and requests.
        assert network.count_received("robot1") - before < len(found) * 0.1 * DECLARED
        # Shaping anew drops what queues: the end of a sample would be lost with it.
        assert eventually(lambda: not network.count_listeners("robot1"), seconds=2.0)


@pytest.mark.parametrize("mbit", [16, 100])
@pytest.mark.parametrize("turn_s", [0.001, 0.03])
def test_a_probe_reads_what_the_link_carries_although_its_host_is_busy(
    network: ShapedNetwork, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, mbit: int, turn_s: float
) -> None:
    """Within 15 %, also where the sender gets its turn three times in the whole probe."""
    monkeypatch.setenv("EDGECTL_STATE_DIR", str(tmp_path / "hosts"))
    network.shape(mbit)
    found: list[float] = []
    while not found or abs(found[-1] - 1) > 0.15:
        assert len(found) < 8, found
        reply = network.sample(0.09, 1.3 * mbit * MBIT, turn_s=turn_s)
        # A machine that is busy itself carries in jerks, or not for long enough to be read.
        found.append((reply["bytes_per_s"] or 0.0) / (0.956 * mbit * MBIT) if reply["full"] else 0.0)


def test_a_link_that_carries_what_is_declared_stays_as_declared(network: ShapedNetwork, site: Site) -> None:
    network.shape(400)
    link = site.probe()
    assert (link.capacity_bytes_per_s, link.capacity_source) == (DECLARED, CapacitySource.DECLARED)
    assert link.nominal is None


@pytest.mark.parametrize(("sender", "by"), [("edge1", "tbf"), ("robot1", "htb")])
def test_a_busy_link_is_read_from_tcp_by_the_end_that_sends_and_is_never_probed(
    network: ShapedNetwork, site: Site, sender: str, by: str
) -> None:
    network.shape(10, by)
    receiver = "robot1" if sender == "edge1" else "edge1"
    with network.traffic(sender, receiver):
        # A machine that is busy itself carries in jerks.
        found = [site.probe(0.5)]
        while not is_near(found[-1], 10):
            assert len(found) < 6, [link.capacity_bytes_per_s / MBIT for link in found]
            found.append(site.probe(0.5))
    assert found[-1].capacity_source is CapacitySource.TCP
    assert site.sampled_at == 0.0


def test_bursts_are_read_in_their_middle(network: ShapedNetwork, site: Site) -> None:
    """Pictures over a link on which each takes 39 or 390 ms: no reading is of the end of one, which TCP confirms late."""
    with network.pictures("robot1", "edge1"):
        for mbit in (16, 1.6):
            network.shape(mbit)
            found: list[float] = []
            for _ in range(30):
                link = site.probe(0.5)
                if link.capacity_source is CapacitySource.TCP:
                    found.append(link.capacity_bytes_per_s / (mbit * MBIT))
                    assert found[-1] > 0.6, "a busy machine carries in jerks"
                    if is_near(link, mbit):
                        break
            else:
                pytest.fail(f"read {found} of the rate")


def test_a_cut_link_is_down_within_three_probes_is_said_once_and_comes_back_with_an_answer(
    network: ShapedNetwork, site: Site
) -> None:
    # Pictures of the test before may still queue: only a robot that has answered once can fall silent.
    assert eventually(lambda: site.probe(0.05).capacity_bytes_per_s and site.answered)
    with network.cut():
        down = [site.probe(0.05).capacity_bytes_per_s for _ in range(4)]
        assert down[2:] == [0.0, 0.0]
    assert site.probe(0.05).capacity_bytes_per_s
    said = [
        (each.kind, each.host, each.message)
        for each in list_events_after(site.fleet, 0)
        if each.kind.startswith("link-")
    ]
    assert said == [
        ("link-down", "edge1", "robot1 does not answer it any more"),
        ("link-back", "edge1", "robot1 answers it again"),
    ]


def test_udp_over_the_cable_is_said_for_the_link(network: ShapedNetwork, site: Site) -> None:
    assert site.probe(0.05).partial == ""
    with network.udp("edge1", "robot1"):
        assert eventually(lambda: site.probe(0.05).partial) == "udp unseen"


def test_probes_are_ten_seconds_apart_and_off_where_the_inventory_says_so(
    network: ShapedNetwork, site: Site, tmp_path: Path
) -> None:
    network.shape(10)
    for _ in range(3):
        # What the last test had sent may still be under way.
        if not site.sampled_at:
            site.probe()
    first = site.sampled_at
    assert first == site.now
    site.now -= 5.0
    site.probe()
    assert site.sampled_at == first
    silent = Site(network, tmp_path / "silent", probe_links=False)
    assert silent.probe().capacity_source is CapacitySource.DECLARED
    assert silent.sampled_at == 0.0
