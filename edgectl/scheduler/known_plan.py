# SPDX-License-Identifier: Apache-2.0
"""Plans of a fleet of which only the CPU in use and the time are others than in a former plan (ADR 167).

Pure. A simulation makes thousands of them. What they are decided from is taken over, all but the CPU, and the
same functions decide them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Verdict
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.resource import CPU
from edgectl.scheduler.assign import PreparedPlan, select_first_placements
from edgectl.scheduler.initial_state import InitialState, RunningTask, find_arrival
from edgectl.scheduler.ledger import Ledger, compute_free_share, count_tasks
from edgectl.scheduler.move_cost import collect_handoff_history
from edgectl.scheduler.task_usage import TaskUsage


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownPlan:
    """What a plan was decided from, to be read again.

    ``left`` and ``reserved``: places with the CPU that running tasks use there, as it was measured, and as it
    counts; in the order in which gamma changed by them.
    """

    prepared: PreparedPlan
    left: tuple[tuple[int, TaskUsage], ...]
    reserved: tuple[tuple[int, TaskUsage], ...]


def remember_plan(prepared: PreparedPlan) -> KnownPlan | None:
    """The plan, to be read again; None where more in it than loads depends on the CPU in use or the time."""
    state, measured, fleet = prepared.how.initial, prepared.measured, prepared.how.context.fleet
    if (
        prepared.pins
        or prepared.how.context.arrays is not None
        or state.replaced
        or state.unseen
        or any(decision.verdict is Verdict.HELD for decision in state.fixed.values())
        or any(sample is not None and sample.standbys for sample in fleet.samples)
        # Something that this plan stops was taken out of gamma.
        or measured.ledger.tasks != count_tasks(fleet)
    ):
        return None
    reserves = state is not measured
    return KnownPlan(
        prepared=prepared,
        left=_list_cpu(_join_resident(measured).values()) if reserves else (),
        reserved=_list_cpu(there for _, there in sorted(_join_resident(state).items())) if reserves else (),
    )


def _join_resident(state: InitialState) -> dict[str, RunningTask]:
    return {**state.held, **state.running}


def _list_cpu(tasks: Iterable[RunningTask]) -> tuple[tuple[int, TaskUsage], ...]:
    return tuple((there.place, TaskUsage(used={CPU.name: there.use.used[CPU.name]})) for there in tasks)


def read_again(
    known: KnownPlan,
    used: Mapping[str, float],
    started: Mapping[str, float],
    manager: ManagerState,
    policy: Policy,
    now: float,
) -> PreparedPlan:
    """As `prepare_plan` makes it of a snapshot that differs from the former one in this alone: the CPU in use
    by host (``used``, cores), and when its tasks were ``started``.

    ``manager`` may have other times, first placements and downtimes than before, ``policy`` another seed. It
    must be as before which tasks have run for long enough to be measured, and in what order several copies of
    one were started.
    """
    prepared = known.prepared
    how, before = prepared.how, prepared.how.initial
    places = how.context.fleet.places
    running = {
        name: RunningTask(
            place=there.place,
            use=there.use,
            since=find_arrival(manager, name, places[there.place].name, started[name]),
            counts=there.counts,
            sample=there.sample,
        )
        for name, there in before.running.items()
    }
    state = replace(before, ledger=_measure_again(known, used), running=running)
    context = replace(
        how.context,
        policy=_take_seed(how.context.policy, policy),
        now=now,
        first=select_first_placements(manager, state),
        handoffs=collect_handoff_history(manager),
    )
    return replace(
        prepared, how=replace(how, context=context, initial=state), policy=_take_seed(prepared.policy, policy)
    )


def _take_seed(known: Policy, policy: Policy) -> Policy:
    return known if known.seed == policy.seed else replace(known, seed=policy.seed)


def _measure_again(known: KnownPlan, used: Mapping[str, float]) -> Ledger:
    """Gamma with other CPU in use: measured, without what running tasks use, and with what they count for."""
    ledger = known.prepared.how.initial.ledger.copy()
    fleet, row = ledger.fleet, [used[host.name] for host in ledger.fleet.places]
    ledger.used[CPU.name] = row
    ledger.free[CPU.name] = [
        compute_free_share(capacity, amount)
        for capacity, amount in zip(fleet.usable[CPU.name], row, strict=True)
    ]
    for place, use in known.left:
        ledger.release(place, use)
    for place, use in known.reserved:
        ledger.charge(place, use)
    return ledger
