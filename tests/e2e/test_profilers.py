# SPDX-License-Identifier: Apache-2.0
"""Profilers over real sshd: they outlive the session that started them, a probe reads them, and without them
a probe only takes longer.
"""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edgectl.agent.measure import system_files
from edgectl.cli import exit_codes
from edgectl.errors import ExitCode, UsageError
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.inventory import Inventory, Role
from edgectl.model.profiler import Profiler, ProfilerState
from edgectl.model.snapshot import Snapshot
from edgectl.usecases import profilers
from edgectl.usecases.probe import probe_fleet
from tests.agent.conftest import eventually, is_running
from tests.builders import an_inventory
from tests.e2e.bench import Bench, a_mark, a_sleeper, a_slice, open_bench
from tests.sshd import Lab

# Much longer than a probe takes that does not wait for it.
ENDLESS = ProbeOptions(window=10.0, timeout=60.0)


def build_inventory(lab: Lab) -> Inventory:
    edges = [a_slice(lab.host(name)) for name in ("edge1", "edge2")]
    return an_inventory(
        *edges,
        a_slice(lab.host("robot1", role=Role.ROBOT)),
        links={("edge1", "robot1"): 10e6, ("edge2", "robot1"): 10e6},
    )


@pytest.fixture
def bench(lab: Lab, tmp_path: Path) -> Iterator[Bench]:
    with open_bench(build_inventory(lab), tmp_path / "manager", lab) as made:
        yield made


def list_states(found: tuple[Profiler, ...]) -> dict[str, ProfilerState]:
    return {each.host: each.state for each in found}


def wait_for_resident_snapshot(bench: Bench) -> Snapshot:
    """Return a snapshot from the profilers of all hosts. A sample that is late on a busy machine costs
    another, short probe.
    """

    def taken() -> Snapshot | None:
        found = bench.probe()
        return found if all(host.resident for host in found.hosts.values()) else None

    found: Snapshot = eventually(taken, seconds=60)
    return found


def test_a_probe_reads_what_the_profilers_measured(lab: Lab, bench: Bench) -> None:
    bench = bench.using(a_sleeper("slam", a_mark(), robots=("robot1",)))
    started = profilers.start_profilers(bench.fleet)
    assert set(list_states(started).values()) == {ProfilerState.STARTED}
    assert all(is_running(each.pid) for each in started), "the session that started them is over"
    assert all(b"edgectl" not in system_files.read_file(f"/proc/{each.pid}/cmdline") for each in started), (
        "the command line tells nothing"
    )

    snapshot = wait_for_resident_snapshot(bench)
    assert all(0.0 <= host.sample_age_s < 30.0 for host in snapshot.hosts.values())
    assert set(snapshot.hosts["edge1"].links) == {"robot1"}
    began = time.monotonic()
    if all(host.resident for host in probe_fleet(bench.fleet, ENDLESS).hosts.values()):
        assert time.monotonic() - began < ENDLESS.window, "no window passed"
    bench.apply()
    assert wait_for_resident_snapshot(bench).hosts["edge1"].tasks["slam"].state.alive

    assert set(list_states(profilers.start_profilers(bench.fleet)).values()) == {
        ProfilerState.ALREADY_RUNNING
    }
    os.kill(started[0].pid, signal.SIGKILL)
    eventually(lambda: not is_running(started[0].pid))
    hosts = bench.probe().hosts
    assert (hosts["edge1"].ok, hosts["edge1"].resident) == (True, False)
    said = {each.host: each for each in profilers.list_profilers(bench.fleet)}
    assert (said["edge1"].state, said["edge1"].detail) == (ProfilerState.NOT_RUNNING, "it was killed")
    assert said["edge2"].state.alive
    assert said["edge2"].current
    assert 0 < said["edge2"].ttl_left <= 3600

    lab["edge2"].stop()
    found = profilers.list_profilers(bench.fleet, ["edge2", "robot1"])
    assert [each.host for each in found] == ["edge2", "robot1"]
    assert (found[0].state, found[1].state.alive) == (ProfilerState.UNREACHABLE, True)
    assert found[0].error
    assert exit_codes.of_profilers(found) is ExitCode.PARTLY
    lab["edge2"].restart()

    stopped = profilers.stop_profilers(bench.fleet)
    assert list_states(stopped)["robot1"] is ProfilerState.STOPPED
    assert exit_codes.of_profilers(stopped) is ExitCode.DONE
    assert not any(is_running(each.pid) for each in started)


def test_wishes_that_make_no_sense_are_refused(bench: Bench) -> None:
    refused: tuple[dict[str, Any], ...] = ({"every": 0.01}, {"every": 61.0}, {"every": 10.0, "ttl": 99.0})
    for wrong in refused:
        with pytest.raises(UsageError):
            profilers.start_profilers(bench.fleet, **wrong)
    with pytest.raises(UsageError, match="unknown host 'edge7'"):
        profilers.stop_profilers(bench.fleet, ["edge7"])
