"""doctor: what is wrong with this machine and the hosts, and what mends it. Nothing is changed."""

import contextlib
from collections.abc import Sequence

from edgectl.doctor.judge import judge
from edgectl.gateway.examine import ExamineOptions, examine
from edgectl.gateway.fanout import fan_out
from edgectl.model.finding import Answers, Diagnosis, Disk, ManagerFacts, NoAnswer
from edgectl.model.inventory import Connection, Host
from edgectl.model.names import known
from edgectl.state.links import load_links
from edgectl.transport.present import has_ssh, known_hosts
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.touch import in_touch

_AT_ONCE = 16


def doctor(fleet: Fleet, state: Disk, names: Sequence[str] = (), *, timeout: float = 15.0) -> Diagnosis:
    """Examine this machine and every host, or only those of ``names``. ``state`` is the fleet's state directory as it stands.

    Raises:
        UsageError: a host is unknown.
    """
    known(names, fleet.inventory.hosts, "host")
    hosts = [host for host in fleet.inventory.hosts.values() if host.probe and (not names or host.name in names)]
    return judge(fleet.inventory, _manager(hosts, state), _answers(fleet, hosts, state, timeout))


def _manager(hosts: Sequence[Host], state: Disk) -> ManagerFacts:
    """Asking ssh_config costs a process per host, so all are asked at once."""
    remote = [host for host in hosts if host.connection is not Connection.LOCAL]
    files = [found for _, found in fan_out(known_hosts, remote, workers=_AT_ONCE)]
    return ManagerFacts(state=state, known_hosts={path: why for found in files for path, why in sorted(found.items())}, ssh=has_ssh())


def _answers(fleet: Fleet, hosts: Sequence[Host], state: Disk, timeout: float) -> Answers:
    """Each request renews what a task with ``self_fence`` lives by: none leaves where that cannot be recorded."""
    if state.obstacle and any(task.self_fence is not None for task in fleet.tasks.tasks.values()):
        hint = f"first mend the state directory {state.path}"
        return {
            host.name: NoAnswer(kind="failed", error="not asked: a task has self_fence, and contacts cannot be kept", hint=hint)
            for host in hosts
        }
    measured = {} if state.obstacle else load_links(fleet.state, fleet.warn)
    with contextlib.nullcontext(fleet) if state.obstacle else in_touch(fleet) as near:
        options = ExamineOptions(timeout=timeout, measured=measured)
        return examine(fleet.inventory, hosts, near.transport, options, clock=fleet.clock)
