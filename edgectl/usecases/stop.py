"""stop and restart: what an operator asks for by name, through the same executor as apply."""

from collections.abc import Sequence

from edgectl.errors import UsageError
from edgectl.executor.manual import restart_plan, running, stop_plan
from edgectl.model.snapshot import Snapshot
from edgectl.usecases.change import Applied, ApplyOptions, Confirm, agreed, carry_out, changing
from edgectl.usecases.fleet import Fleet
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
    """Stop a running task and start it again on its host.

    Raises:
        UsageError: it is not in the files, or does not run.
        LockBusyError: another edgectl is changing this fleet.
    """
    options = options or ApplyOptions()
    with changing(fleet, "restart", options) as held:
        snapshot = probe(held, options.probe)
        _known(fleet, [name], snapshot)
        if name not in fleet.tasks.tasks or name not in running(snapshot):
            raise UsageError(
                f"{name} does not run" if name in fleet.tasks.tasks else f"{name} is not in the task files", hint="edgectl apply"
            )
        return carry_out(held, restart_plan(name, fleet.inventory, fleet.tasks, snapshot), confirm, options, verb="restart")


def _known(fleet: Fleet, names: Sequence[str], snapshot: Snapshot) -> list[str]:
    places = running(snapshot)
    for name in names:
        if name not in places and name not in fleet.tasks.tasks:
            raise UsageError(f"no task {name}", hint="edgectl status lists them")
    return list(dict.fromkeys(names))
