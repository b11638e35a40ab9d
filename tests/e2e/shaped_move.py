# SPDX-License-Identifier: Apache-2.0
"""Moves of a large state over SSH between two hosts, each behind a link of its own; run in a network namespace.

``unshare --net python -m tests.e2e.shaped_move FOLDER``: prints one JSON object for each move.
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from edgectl.model.check import Check
from edgectl.model.inventory import Host
from edgectl.model.result import ActionResult, Outcome
from edgectl.model.standby import Activation, SaveMoment, StandbyRule, StateRule
from edgectl.model.task import Task
from edgectl.usecases.apply import ApplyOptions, plan_and_apply
from tests.builders import a_task, an_inventory
from tests.e2e.bench import EAGER, GENTLE, QUICK, Bench, a_slice, open_bench
from tests.faults.network import run_ip, run_tc
from tests.handoffs.scene import Scene
from tests.handoffs.subscriber import Subscriber
from tests.sshd import Lab, running_lab

MBIT = 50
SMALL, MIDDLE, LARGE = 100_000, 10_000_000, 80_000_000
_HEADERS = 1.044  # of Ethernet, IP and TCP, which the links carry too


def shape_links(addresses: list[str]) -> None:
    """Let what each host sends, and what it receives, have so many Mbit/s; nothing else is limited."""
    words = [
        "qdisc add dev lo root handle 1: htb default 1",
        "class add dev lo parent 1: classid 1:1 htb rate 10gbit",
    ]
    ways = [f"{way} {address}" for address in addresses for way in ("src", "dst")]
    for number, way in enumerate(ways, 10):
        rate = f"htb rate {MBIT}mbit burst 32kb cburst 32kb"
        words += [
            f"class add dev lo parent 1: classid 1:{number} {rate}",
            f"filter add dev lo parent 1: protocol ip prio 1 u32 match ip {way} flowid 1:{number}",
        ]
    for each in words:
        assert not run_tc(*each.split(), netns=os.getpid()), each


def remove_shape() -> None:
    assert not run_tc(*["qdisc", "del", "dev", "lo", "root"], netns=os.getpid())


def apply(bench: Bench, task: Task, host: str) -> ActionResult:
    placed = replace(task, hosts=replace(task.hosts, pin=host))
    applied = plan_and_apply(bench.using(placed).fleet, EAGER, options=ApplyOptions(probe=QUICK))
    assert applied.results is not None
    result = applied.results.actions[0]
    assert result.outcome is Outcome.DONE, result
    return result


def measure_move(folder: Path, size: int, move: Callable[[], ActionResult]) -> None:
    """Print what ``move`` took, with a state of ``size`` random bytes."""
    # By programs of their own: the state shall never have been in the memory of this one.
    subprocess.run(f"head -c {size} /dev/urandom > {folder}/source", shell=True, check=True)
    began = time.monotonic()
    result = move()
    took = time.monotonic() - began
    subprocess.run(["cmp", str(folder / "source"), str(folder / "loaded")], check=True)
    assert result.state is not None
    found = {
        "bytes": size,
        "transfer_s": result.state.transfer_s,
        "save_s": result.state.save_s,
        "load_s": result.state.load_s,
        "age_s": result.state.age_s,
        "gap_s": result.downtime_s,
        "bound_s": size * 8 * _HEADERS / (MBIT * 1e6),
        "apply_s": took,
        "peak_kib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
    }
    print(json.dumps(found), flush=True)


def main(folder: Path) -> None:
    run_ip("link", "set", "lo", "mtu", "1500")
    run_ip("link", "set", "lo", "up")
    rule = StateRule(
        save=Check(command=f"exec cat {folder}/source"), load=Check(command=f"exec cat > {folder}/loaded")
    )
    task = a_task("slam", cpu=0.5, command="exec sleep 600", up=0.1, stop=GENTLE, state=rule)
    with running_lab(folder / "lab", ["edge1", "edge2"]) as lab:
        os.environ.update(lab.environment)
        hosts = [_make_host(lab, name) for name in ("edge1", "edge2")]
        with open_bench(an_inventory(*hosts), folder / "manager", lab) as bench:
            apply(bench, task, "edge1")
            measure_move(folder, SMALL, lambda: apply(bench, task, "edge2"))
            shape_links([lab[name].address for name in ("edge1", "edge2")])
            measure_move(folder, MIDDLE, lambda: apply(bench, task, "edge1"))
            remove_shape()
            measure_move(folder, LARGE, lambda: apply(bench, task, "edge2"))
            scene = Scene(bench, ("edge1", "edge2"), make_warm_task(task, folder), Subscriber())
            scene.apply("edge1")
            shape_links([lab[name].address for name in ("edge1", "edge2")])
            measure_move(folder, MIDDLE, lambda: scene.apply("edge2").actions[0])


def make_warm_task(task: Task, folder: Path) -> Task:
    """The task with a copy and its state saved before; a second active instance could not make its directory."""
    activation = Activation(
        activate=Check(command=f"exec mkdir {folder}/active"),
        deactivate=Check(command=f"test ! -e {folder}/active || exec rmdir {folder}/active"),
    )
    assert task.state is not None
    rule = replace(task.state, moment=SaveMoment.ACTIVE)
    return replace(task, name="mapping", state=rule, standby=StandbyRule(activation=activation))


def _make_host(lab: Lab, name: str) -> Host:
    return a_slice(lab.host(name))


def run_moves(folder: Path) -> list[dict[str, float]]:
    """Run the program in a network namespace; the figures of its moves: small, in shaped links, large, warm in
    shaped links.
    """
    done = subprocess.run(
        ["unshare", "--net", sys.executable, "-m", "tests.e2e.shaped_move", str(folder)],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(__file__).parents[2],
    )
    assert not done.returncode, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
