# SPDX-License-Identifier: Apache-2.0
"""Short form of ``make soak``: a few hundred cycles without growth, and proof that growth is found."""

import threading
from pathlib import Path

from tests.soak import simulated_hosts, ssh_hosts
from tests.soak.resource_readings import TOLERANCE, list_growth, take_reading
from tests.sshd import Lab


def test_the_gauge_sees_what_grows() -> None:
    before = take_reading()
    kept: tuple[list[object], list[list[object]]] = (
        [object() for _ in range(10)],
        [[] for _ in range(TOLERANCE.objects + 100)],
    )
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    with Path("/dev/null").open():
        after = take_reading()
    over.set()
    thread.join()
    assert [each.split()[0] for each in list_growth(before, after)] == ["files", "threads", "objects"]
    assert len(kept) == 2
    assert list_growth(before, before) == []


def test_a_watch_over_simulated_hosts_grows_nothing() -> None:
    warm, end, counts = simulated_hosts.soak_simulated_hosts(200, quiet=70, warm_at=0.5)
    assert list_growth(warm, end) == []
    assert counts["losses"] > 0
    assert counts["starts"] > len(simulated_hosts.build_tasks().tasks)
    assert counts["errors"] == 0


def test_a_watch_over_real_hosts_of_which_one_dies_and_returns_grows_nothing(
    lab: Lab, tmp_path: Path
) -> None:
    warm, end, counts = ssh_hosts.soak_ssh_hosts(
        lab, tmp_path, 18, ssh_hosts.OutageSchedule(period=5, dead=3, quiet=10)
    )
    assert list_growth(warm, end) == []
    assert (counts["losses"], counts["errors"], counts["left behind"]) == (1, 0, 0)
    assert counts["starts"] > 3, "what the dead host lost was started again"
