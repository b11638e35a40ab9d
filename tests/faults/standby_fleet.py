# SPDX-License-Identifier: Apache-2.0
"""A task with standby copies on the hosts of a fleet: its moves, what strikes them, and the verdict on its memory.

The records of the task are of its activities (`standby_task`), so that the oracle counts two that are active at once,
and none that is active, as it counts two launches and none. Its messages are heard beside the manager.
"""

from typing import Any

from tests.faults import oracle
from tests.faults.command_result import ExpectationError
from tests.faults.failpoint_runner import read_failpoints
from tests.faults.faults_failpoints import APPLY_ONE
from tests.faults.fleet import FaultFleet, repair_fleet
from tests.faults.hosts import wait_for

TASK = "slam"
# A directory that the task has in a container, too.
PIPES = "$HOME/oracle/records/standby-slam"
HOOKS = "hooks"
GRACE_S = 2.0
STATE = {
    "save": f'echo tell > {PIPES}/in && read answer < {PIPES}/out && echo "$answer"',
    "load": f'read count && echo "take $count" > {PIPES}/in && read answer < {PIPES}/out && test "$answer" = take',
}
"""The number of times that it has worked, which it keeps in memory alone."""


def say_word(word: str) -> str:
    """A command that succeeds once the task has done what ``word`` says."""
    return f'echo {word} > {PIPES}/in && read answer < {PIPES}/out && test "$answer" = {word}'


def note_hook(word: str) -> str:
    """A hook that notes ``word`` on the host where it runs."""
    return f'echo "{word} $(date +%s%N)" >> "$HOME/oracle/records/{HOOKS}"'


HOLD = {word: {"command": note_hook(word), "on": "host"} for word in ("hold", "release")}


def start_standby_task(fleet: FaultFleet, **fields: Any) -> None:
    """Start slam, which is not bound to a host, and its copy."""
    heard = fleet.subscribe()
    fleet.policy = {"min_dwell": "0s", "move_margin": 0.01, "weights": "cpu"}
    fleet.add_task(TASK, **fields)
    words = f'"$HOME/oracle/records" {TASK} {PIPES} {heard.address} {heard.port} {fleet.mark}'
    fleet.tasks[TASK] |= {
        "command": f'exec python3 "$HOME/oracle/standby_task.py" {words}',
        "demand": {"cpu": 0.8, "memory": "10Mi"},
        "stop": {"grace": f"{GRACE_S:g}s"},
        "standby": {
            "warm": {"hosts": 1},
            "activate": {"command": say_word("wake"), "timeout": "5s"},
            "deactivate": {"command": say_word("sleep"), "timeout": "5s"},
            "ready": {"command": f"test -p {PIPES}/out", "timeout": "20s"},
        },
    }
    if fleet.engines:
        # Its pipes are for its own user only, who writes into them on the host.
        fleet.tasks[TASK]["image"] = fleet.build_image(user="4711:4711")
    fleet.write_files()
    fleet.apply_and_check()
    wait_for(lambda: heard.count, "a message of the task")


def find_active(fleet: FaultFleet) -> str:
    """The host on which slam is active."""
    return oracle.watch_launches(fleet.records, seconds=0.3, patience=12.0, expected=[TASK])[TASK][0].host


def force_move(fleet: FaultFleet) -> str:
    """Forbid slam the host on which it is active; returns that host."""
    old = find_active(fleet)
    fleet.tasks[TASK]["hosts"] = {"never": [old]}
    fleet.write_files()
    return old


def leave_host(fleet: FaultFleet, _number: int) -> tuple[str, ...]:
    """A warm move, after which the old instance ends; and a copy elsewhere."""
    force_move(fleet)
    return APPLY_ONE


def change_places(fleet: FaultFleet, number: int) -> tuple[str, ...]:
    """Another host becomes by far the best: a warm move, after which the old instance stays as a copy."""
    fleet.tasks[TASK].pop("hosts", None)
    old = find_active(fleet)
    others = [name for name in fleet.inventory if name != old]
    best = others[number % len(others)]
    for name, host in fleet.inventory.items():
        host["capacity"] = {"cpu": 16 if name == best else 1, "memory": "8Gi"}
    fleet.write_files()
    return APPLY_ONE


def find_copy(fleet: FaultFleet) -> str:
    """The host that has the copy, by edgectl; any other than that of the active instance if there is none."""
    hosts = fleet.run_edgectl("probe", "-o", "json").expect_exit(0, 4).data["hosts"]
    assert isinstance(hosts, dict)
    found = [name for name, host in hosts.items() if TASK in host.get("standbys", {})]
    return found[0] if found else next(name for name in fleet.edges if name != find_active(fleet))


def check_memory(fleet: FaultFleet) -> None:
    """Require that no activity began with less than what the task knew before."""
    known, last = 0, ""
    for life in oracle.list_lifetimes(fleet.records):
        counts = oracle.read_counts(fleet.records[life.host], life.launch)
        if life.first_ns >= fleet.started_ns and counts and counts[0] < known:
            points = ", ".join(read_failpoints(fleet.failpoint_log)[-3:])
            raise ExpectationError(
                f"forgotten: active on {life.host} with {counts[0]} of {known}, after {last}; {points}"
            )
        known, last = max(known, *counts, 0), life.host


def check_released(fleet: FaultFleet) -> None:
    """Require that the last hook of all hosts was a release."""
    said = [
        (int(ns), word)
        for records in fleet.records.values()
        if (records / HOOKS).exists()
        for word, ns in (line.split() for line in (records / HOOKS).read_text().splitlines())
    ]
    if said and max(said)[1] != "release":
        raise ExpectationError(f"still on hold: {sorted(said)[-4:]}")


def repair_and_check(fleet: FaultFleet) -> None:
    """Repair everything; one apply, after which exactly one is active and nobody is on hold."""
    repair_fleet(fleet)
    fleet.run_edgectl(*APPLY_ONE).expect_exit(0)
    fleet.check_verdict()
    check_released(fleet)
