"""Plans that an operator asks for by name: stop these, restart that. Pure."""

import dataclasses
from collections.abc import Iterable

from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.inventory import Inventory
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.snapshot import HostSample, Snapshot
from edgectl.model.task import Tasks


def running(snapshot: Snapshot) -> dict[str, dict[str, str]]:
    """The managed tasks that have processes, each with its instances by host, in the order of the hosts."""
    found: dict[str, dict[str, str]] = {}
    for host, sample in snapshot.hosts.items():
        for name, task in sample.tasks.items():
            if task.managed and (task.state.alive or task.pid > 0):
                found.setdefault(name, {})[host] = task.instance
    return found


def stop_plan(names: Iterable[str], inventory: Inventory, tasks: Tasks, snapshot: Snapshot) -> Plan:
    """Stop the named tasks wherever they run; those that do not run need no step."""
    places = running(snapshot)
    steps = []
    for name in names:
        if name in places:
            decision = Decision(task=name, verdict=Verdict.UNPLACED, reason=Reason.OPERATOR, previous_host=next(iter(places[name])))
            steps.append(Step(decision=decision, action=Action.STOP, instances=places[name]))
    return _plan(tuple(steps), inventory, tasks, snapshot)


def restart_plan(name: str, inventory: Inventory, tasks: Tasks, snapshot: Snapshot) -> Plan:
    """Stop a running task and start it again on its host; further instances elsewhere are stopped."""
    places = running(snapshot)[name]
    host, *others = places
    decision = Decision(task=name, verdict=Verdict.KEPT, reason=Reason.OPERATOR, host=host, previous_host=host)
    return _plan((Step(decision=decision, action=Action.RESTART, instances=places, stop=tuple(others)),), inventory, tasks, snapshot)


def forgive(name: str, snapshot: Snapshot) -> Snapshot:
    """``snapshot`` without the runs of a task that were given up; their generations stay known."""
    return dataclasses.replace(snapshot, hosts={host: _forgiven(name, sample) for host, sample in snapshot.hosts.items()})


def _forgiven(name: str, sample: HostSample) -> HostSample:
    run = sample.tasks.get(name)
    if run is None or not run.given_up:
        return sample
    others = {task: other for task, other in sample.tasks.items() if task != name}
    return dataclasses.replace(sample, tasks=others, generations={**sample.generations, name: run.generation})


def _plan(steps: tuple[Step, ...], inventory: Inventory, tasks: Tasks, snapshot: Snapshot) -> Plan:
    return Plan(
        created_at=snapshot.taken_at,
        policy=tasks.policy,
        inventory_digest=inventory.digest,
        tasks_digest=tasks.digest,
        snapshot=snapshot,
        settled=True,
        steps=steps,
        expected={},
    )
