# SPDX-License-Identifier: Apache-2.0
"""Faults of the agents that serve the requests of a connection, and of hosts that allow one of them alone or none that
stays.
"""

import os
import signal
import subprocess
import time
from contextlib import suppress

from tests.faults.command_result import ExpectationError
from tests.faults.faults_host import start_tasks
from tests.faults.faults_link import list_waiting_processes, prepare_changes
from tests.faults.fleet import APPLY, FaultFleet
from tests.faults.hosts import Host, wait_for
from tests.faults.registry import ALL, OWN, fault
from tests.faults.scan import Process
from tests.pace import patience

# Of the login: it runs a command once all of its input is there.
READING_FIRST = "ForceCommand sh -c 'f=$(mktemp) && cat >$f && sh -c \"$SSH_ORIGINAL_COMMAND\" <$f; rm -f $f'"

# From the cut of a link to the end of the agent that nobody can reach any more, seconds.
MOST_AFTER_CUT_S = 2.0


def signal_agents(fleet: FaultFleet, host: str, number: signal.Signals) -> list[int]:
    """Send a signal to every agent of a host that an open connection has; return their pids."""
    found = [each for each in list_waiting_processes(fleet.hosts[host]) if each.alive]
    for each in found:
        with suppress(ProcessLookupError):
            os.kill(each.pid, number)
    return [each.pid for each in found]


def strike_until_end(fleet: FaultFleet, running: "subprocess.Popen[str]", pauses: tuple[float, float]) -> int:
    """Kill the agents of a random host again and again while edgectl runs; return how many."""
    killed, pids = 0, set[int]()
    while running.poll() is None:
        found = signal_agents(fleet, fleet.random.choice(fleet.edges), signal.SIGKILL)
        killed += len(set(found) - pids)
        pids.update(found)
        time.sleep(fleet.random.uniform(*pauses))
    return killed


@fault("agent killed at a random moment of an apply", quick=True, full=12, kinds=ALL)
def kill_agents_once(fleet: FaultFleet) -> None:
    """What it was asked is asked again over a new login, so nearly every apply succeeds as well."""
    prepare_changes(fleet)
    running = fleet.start_edgectl(*APPLY)
    fleet.wait(fleet.random.uniform(0.3, 2.2))
    signal_agents(fleet, fleet.random.choice(fleet.edges[:3]), signal.SIGKILL)
    fleet.wait_for_edgectl(running).expect_exit(0, 1, 4, within=60)


@fault("agents killed again and again during an apply", full=8, kinds=ALL)
def kill_agents_again(fleet: FaultFleet) -> None:
    prepare_changes(fleet)
    running = fleet.start_edgectl(*APPLY)
    killed = strike_until_end(fleet, running, (0.05, 0.6))
    fleet.wait_for_edgectl(running).expect_exit(0, 1, 4, within=100)
    if not killed:
        raise ExpectationError("no agent was there")


@fault("agent frozen in the middle of an apply, and woken", quick=True, full=10, kinds=ALL)
def freeze_agent(fleet: FaultFleet) -> None:
    """Shorter than its silence it goes on; longer it begins nothing any more, for its manager has asked elsewhere."""
    prepare_changes(fleet)
    host = fleet.random.choice(fleet.edges[:3])
    running = fleet.start_edgectl(*APPLY)
    fleet.wait(fleet.random.uniform(0.3, 2.2))
    frozen = signal_agents(fleet, host, signal.SIGSTOP)
    fleet.wait(fleet.random.choice([0.5, 1.7, 1.9, 4.0]))
    for pid in frozen:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
    fleet.wait_for_edgectl(running).expect_exit(0, 1, 4, within=100)


@fault("agents killed again and again under a watch that applies", full=4, kinds=ALL)
def kill_agents_of_watch(fleet: FaultFleet) -> None:
    start_tasks(fleet)
    fleet.add_task("map", on=fleet.first)
    running = fleet.start_edgectl("watch", "--apply", "--every", "1s", "--cycles", "8")
    strike_until_end(fleet, running, (0.3, 1.5))
    fleet.wait_for_edgectl(running, ("watch",)).expect_exit(0, 1, 4)
    if any(fleet.count_launches(task) != 1 for task in ("slam", "nav", "grip")):
        raise ExpectationError("a task was started again")


@fault("link cut under a watch: its agent ends within 2 s", quick=True, full=4, kinds=(*OWN, "systemd"))
def cut_link_of_watch(fleet: FaultFleet) -> None:
    """The host hears nothing of the end of the line. Its task goes on, and the other hosts are watched."""
    start_tasks(fleet)
    computer = fleet.get_computer(fleet.random.choice(fleet.edges[:3]))
    # With room for one channel no agent stays.
    computer.set_server_options()
    running = fleet.start_edgectl("watch", "--every", "1s")
    agent, *children = await_staying_agent(computer)
    fleet.random.choice([computer.drop_packets, computer.unplug_cable])()
    cut_at = time.monotonic()
    wait_for(lambda: not agent.alive, "the end of the agent", 20)
    if (seconds := time.monotonic() - cut_at) > patience(MOST_AFTER_CUT_S):
        raise ExpectationError(f"the agent ended {seconds:.2f} s after the link was cut")
    wait_for(lambda: not any(each.alive for each in children), "the end of its requests")
    fleet.check_verdict()
    computer.plug_in_cable()
    await_staying_agent(computer)
    with suppress(ProcessLookupError):
        os.killpg(running.pid, signal.SIGTERM)
    fleet.wait_for_edgectl(running, ("watch",)).expect_exit(0, 4, 130, 143, within=100)
    if any(fleet.count_launches(task) != 1 for task in fleet.expected):
        raise ExpectationError("a task was started again")


def await_staying_agent(host: Host) -> list[Process]:
    """Wait until an agent stays on the host and serves a request; both, the agent first."""
    found: list[Process] = []

    def find() -> bool:
        agents = {each.pid: each for each in list_waiting_processes(host)}
        children = [each for each in host.processes() if each.parent in agents]
        found[:] = [agents[children[0].parent], *children] if children else []
        return bool(found)

    wait_for(find, "an agent that stays", 60)
    return found


@fault("hosts with room for one channel per connection (MaxSessions 1)", quick=True, full=3, kinds=ALL)
def allow_one_channel(fleet: FaultFleet) -> None:
    """Whatever edgectl does works there, without an error and in the usual time."""
    for host in fleet.hosts.values():
        host.set_server_options("MaxSessions 1")
    use_everything(fleet, within=60)


@fault("a login that reads all its input before it runs anything", quick=True, full=3, kinds=ALL)
def read_input_first(fleet: FaultFleet) -> None:
    """No agent can stay there, so each request is a call."""
    for host in (fleet.first, fleet.third):
        fleet.hosts[host].set_server_options(READING_FIRST)
    use_everything(fleet, within=60)


def use_everything(fleet: FaultFleet, *, within: float) -> None:
    """Start, move, watch with and without changes, read logs and stop; each of it succeeds."""
    prepare_changes(fleet)
    fleet.apply().expect_exit(0, within=within)
    fleet.check_verdict()
    fleet.run_edgectl("watch", "--every", "1s", "--cycles", "7").expect_exit(0, within=within)
    fleet.pin_task("map", fleet.second)
    fleet.run_edgectl("watch", "--apply", "--every", "1s", "--cycles", "5").expect_exit(0, within=within)
    fleet.check_verdict()
    fleet.run_edgectl("status").expect_exit(0, within=within)
    fleet.run_edgectl("logs", "slam").expect_exit(0, within=within)
    if fleet.count_launches("grip") != 1:
        raise ExpectationError("grip was started again")
