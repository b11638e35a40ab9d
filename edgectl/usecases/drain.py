"""drain: close hosts and move away what runs there, through the handoff contracts, until a deadline."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from edgectl.executor.manual import running
from edgectl.model.memory import Memory
from edgectl.model.names import known
from edgectl.model.plan import Plan
from edgectl.model.policy import Policy
from edgectl.model.result import Outcome
from edgectl.model.snapshot import Snapshot
from edgectl.state.memory import load_memory, save_memory
from edgectl.usecases.change import Applied, ApplyOptions, Confirm, agreed, carry_out, changing
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.plan import plan as make_plan
from edgectl.usecases.probe import probe

_PAUSE_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Drained:
    """Every pass that did something (else the first), in order, and what is still on the hosts, or may be: (task, host)."""

    passes: tuple[Applied, ...]
    left: tuple[tuple[str, str], ...] = ()

    @property
    def applied(self) -> Applied:
        """The last pass, which tells how it ended."""
        return self.passes[-1]

    @property
    def done(self) -> bool:
        """Whether the hosts are empty."""
        return not self.left and not self.applied.declined


def drain(
    fleet: Fleet,
    policy: Policy,
    names: Sequence[str],
    confirm: Confirm = agreed,
    options: ApplyOptions | None = None,
    *,
    timeout: float = 300.0,
    pause: Callable[[float], None] = time.sleep,
) -> Drained:
    """Close ``names`` to new tasks and move theirs away; what is deferred or fails is tried again until ``timeout`` seconds have passed.

    Asked once, before anything is done; ``uncordon`` opens the hosts again. Nothing else moves.

    Raises:
        UsageError: a host is unknown.
        LockBusyError: another edgectl is changing this fleet.
    """
    known(names, fleet.inventory.hosts, "host")
    deadline = time.monotonic() + timeout
    options = dataclasses.replace(options or ApplyOptions(), deadline=deadline)
    with changing(fleet, "drain", options) as held:

        def begin(plan: Plan) -> bool:
            return confirm(plan) and _closed(held, names)

        made = _plan(held, policy, names, options)
        if not made.changes:
            _closed(held, names)
        passes = [carry_out(held, made, begin, options, verb="drain")]
        while _worth_another_try(passes[-1], options, deadline):
            pause(min(_PAUSE_S, max(0.0, deadline - time.monotonic())))
            made = _plan(held, policy, names, options)
            if not made.changes:
                break
            passes.append(carry_out(held, made, agreed, options, verb="drain"))
        return Drained(passes=tuple(passes), left=() if passes[-1].declined else _left(held, names, made, options))


def _plan(fleet: Fleet, policy: Policy, names: Sequence[str], options: ApplyOptions) -> Plan:
    """The plan of the drained hosts' tasks alone, decided as if the mark were set already. Nothing moves for another reason."""
    snapshot = probe(fleet, options.probe)
    memory = snapshot.memory or Memory()
    closed = dataclasses.replace(memory, cordons=memory.cordons | set(names), draining=memory.draining | set(names))
    still = dataclasses.replace(policy, attended=False, max_moves=0)
    made = make_plan(fleet, still, snapshot=dataclasses.replace(snapshot, memory=closed))
    leaving = _tasks_on(snapshot, names) | {task for task, placement in memory.placements.items() if placement.host in names}
    return dataclasses.replace(made, steps=tuple(step for step in made.steps if step.task in leaving), expected={})


def _tasks_on(snapshot: Snapshot, names: Sequence[str]) -> set[str]:
    return {task for task, places in running(snapshot).items() if not places.keys().isdisjoint(names)}


def _closed(fleet: Fleet, names: Sequence[str]) -> bool:
    memory = load_memory(fleet.state, fleet.warn)
    save_memory(fleet.state, dataclasses.replace(memory, cordons=memory.cordons | set(names), draining=memory.draining | set(names)))
    return True


def _worth_another_try(applied: Applied, options: ApplyOptions, deadline: float) -> bool:
    """Whether something went wrong that may go right, and there is time for it."""
    results = applied.results
    if results is None or options.stop_requested.is_set() or time.monotonic() >= deadline:
        return False
    failed = any(action.outcome is Outcome.FAILED for action in results.actions)
    return not results.done and not (failed and options.fail_fast)


def _left(fleet: Fleet, names: Sequence[str], made: Plan, options: ApplyOptions) -> tuple[tuple[str, str], ...]:
    """What still runs on the hosts, and what was known on those that do not answer."""
    snapshot = probe(fleet, options.probe)
    seen = [(task, host) for task, places in running(snapshot).items() for host in places if host in names]
    silent = {host for host in names if host in snapshot.hosts and not snapshot.hosts[host].ok}
    return (*seen, *((step.task, host) for step in made.steps if (host := step.decision.previous_host) is not None and host in silent))
