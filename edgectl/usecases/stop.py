"""stop and restart: what an operator asks for by name, through the same executor as apply."""

import dataclasses
from collections.abc import Sequence

from edgectl.errors import UsageError
from edgectl.executor.manual import forgive, restart_plan, running, stop_plan
from edgectl.model.names import known
from edgectl.model.plan import Action, Plan
from edgectl.model.snapshot import Snapshot
from edgectl.usecases.change import Applied, ApplyOptions, Confirm, agreed, carry_out, changing
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import plan
from edgectl.usecases.probe import probe


def stop(fleet: Fleet, names: Sequence[str] | None, confirm: Confirm = agreed, options: ApplyOptions | None = None) -> Applied:
    """Stop the named tasks (None: all) wherever they run. The next apply starts them again, unless they are marked done.

    Raises:
        UsageError: a name is neither in the files nor running.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with changing(fleet, "stop", options) as held:
        snapshot = probe(held, options.probe)
        wanted = list(running(snapshot)) if names is None else _known(fleet, names, snapshot)
        return carry_out(held, stop_plan(wanted, fleet.inventory, fleet.tasks, snapshot), confirm, options, verb="stop")


def restart(fleet: Fleet, name: str, confirm: Confirm = agreed, options: ApplyOptions | None = None) -> Applied:
    """Stop a running task and start it again on its host; one that was given up is started where it is placed now.

    Raises:
        UsageError: it is not in the files, neither runs nor was given up, or has no place now.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with changing(fleet, "restart", options) as held:
        snapshot = probe(held, options.probe)
        _known(fleet, [name], snapshot)
        return carry_out(held, _restarted(held, name, snapshot), confirm, options, verb="restart")


def _restarted(fleet: Fleet, name: str, snapshot: Snapshot) -> Plan:
    if name not in fleet.tasks.tasks:
        raise UsageError(f"{name} is not in the task files", hint="edgectl apply")
    if name in running(snapshot):
        return restart_plan(name, fleet.inventory, fleet.tasks, snapshot)
    forgiven = forgive(name, snapshot)
    if forgiven == snapshot:
        raise UsageError(f"{name} does not run", hint="edgectl apply")
    made = plan(fleet, fleet.tasks.policy, snapshot=forgiven)
    steps = tuple(step for step in made.steps if step.task == name and step.action is Action.START)
    if not steps:
        raise UsageError(f"{name} has no place now", hint=f"edgectl reopen {name}; edgectl plan then says why")
    return dataclasses.replace(made, steps=steps, expected={})


def _known(fleet: Fleet, names: Sequence[str], snapshot: Snapshot) -> list[str]:
    known(names, [*fleet.tasks.tasks, *running(snapshot)], "task")
    return list(dict.fromkeys(names))
