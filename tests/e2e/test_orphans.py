# SPDX-License-Identifier: Apache-2.0
"""Tasks whose supervisor was killed, over real sshd: adopted by apply, and never replaced while unseen."""

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from edgectl.agent.supervise import records
from edgectl.model.plan import Action
from edgectl.model.task import RestartPolicy, UnreachablePolicy
from edgectl.usecases.probe import probe_fleet
from edgectl.views.reasons import describe_reason
from tests.builders import an_inventory
from tests.e2e.bench import (
    QUICK,
    Bench,
    a_mark,
    a_sleeper,
    list_sleepers,
    open_bench,
    wait_for_sleepers,
)
from tests.e2e.test_inventory_changes import list_edges
from tests.e2e.test_unreachable import cut_off, restore_server, wait_until
from tests.sshd import Lab


@pytest.fixture
def bench(lab: Lab, tmp_path: Path) -> Iterator[Bench]:
    inventory = an_inventory(*list_edges(lab))
    with open_bench(inventory, tmp_path / "manager", lab) as made:
        yield made


def kill_supervisor(lab: Lab, host: str, task: str) -> None:
    (folder,) = lab[host].home.rglob(f"tasks/{task}")
    os.kill(int(records.read_record(str(folder / "instance"))["supervisor"]), signal.SIGKILL)


def test_apply_adopts_an_orphan_and_its_restart_policy_works_again(lab: Lab, bench: Bench) -> None:
    mark = a_mark()
    bench = bench.using(a_sleeper("slam", mark, restart=RestartPolicy.ALWAYS))
    bench.apply()
    before = sorted(wait_for_sleepers(mark))
    kill_supervisor(lab, bench.where()["slam"], "slam")
    wait_until(lambda: bench.sample("slam").orphaned, 10.0)
    applied = bench.apply()
    (step,) = applied.plan.steps
    assert (step.action, describe_reason(step)) == (
        Action.ADOPT,
        "adopt: its supervisor was lost; a new one takes over",
    )
    assert sorted(list_sleepers(mark)) == before
    assert bench.actions() == {"slam": Action.KEEP}
    os.kill(bench.sample("slam").pid, signal.SIGKILL)
    wait_until(lambda: bench.sample("slam").restarts == 1, 10.0)
    assert len(wait_for_sleepers(mark)) == 2
    bench.stop()
    assert list_sleepers(mark) == []


def test_an_orphan_on_a_silent_host_is_held_although_it_should_fence_itself(lab: Lab, bench: Bench) -> None:
    mark = a_mark()
    fenced = a_sleeper(
        "slam", mark, on_unreachable=UnreachablePolicy.REPLACE, replace_after=1.0, self_fence=60.0
    )
    bench = bench.using(fenced)
    bench.apply()
    host = bench.where()["slam"]
    running = sorted(wait_for_sleepers(mark))
    kill_supervisor(lab, host, "slam")
    assert bench.sample("slam").orphaned
    cut_off(lab[host])
    # Long after the last contact, by every clock of the manager.
    later = replace(
        bench.fleet, uptime=lambda: replace(now := bench.fleet.uptime(), seconds=now.seconds + 3600.0)
    )
    (step,) = Bench(replace(later, clock=lambda: time.time() + 3600.0)).plan().steps
    assert (step.action, step.decision.amount) == (Action.HOLD, None)
    assert sorted(list_sleepers(mark)) == running
    restore_server(lab[host])
    assert bench.actions() == {"slam": Action.ADOPT}
    bench.apply()
    snapshot = probe_fleet(bench.fleet, QUICK)
    assert snapshot.manager is not None
    assert snapshot.manager.orphans == {}
    assert sorted(list_sleepers(mark)) == running
