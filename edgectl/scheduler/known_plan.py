# SPDX-License-Identifier: Apache-2.0
"""Plans of a fleet of which only the CPU in use and the time are others than in a former plan (ADR 167).

Pure. A simulation makes thousands of them. What they are decided from is taken over, all but the CPU, and the
same functions decide them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from edgectl.dataclass import dataclass
from edgectl.model.assignment import Verdict
from edgectl.model.manager_state import ManagerState
from edgectl.model.policy import Policy
from edgectl.model.resource import CPU
from edgectl.scheduler.assign import PreparedPlan, select_first_placements
from edgectl.scheduler.capacities import Capacities
from edgectl.scheduler.initial_state import InitialState, RunningTask, find_arrival
from edgectl.scheduler.ledger import Ledger, compute_free_share, count_tasks
from edgectl.scheduler.move_cost import MIN_DOWNTIME_SAMPLES, collect_handoff_history
from edgectl.scheduler.stay_limits import StayLimits


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownPlan:
    """What a plan was decided from, to be read again.

    ``left`` and ``reserved``: places with the CPU that running tasks use there, as it was measured, and as it
    counts; in the order in which gamma changed by them.
    """

    prepared: PreparedPlan
    left: tuple[tuple[int, float], ...]
    reserved: tuple[tuple[int, float], ...]


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


def _list_cpu(tasks: Iterable[RunningTask]) -> tuple[tuple[int, float], ...]:
    return tuple((there.place, there.use.used[CPU.name]) for there in tasks)


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
    ledger.used[CPU.name] = row = _count_cpu(known, used)
    ledger.free[CPU.name] = _list_free_shares(ledger.fleet, row)
    return ledger


def _count_cpu(known: KnownPlan, used: Mapping[str, float]) -> list[float]:
    """Gamma of the CPU by place, by the same sums as the ledger makes them."""
    row = [used[host.name] for host in known.prepared.how.context.fleet.places]
    for place, amount in known.left:
        row[place] = max(0.0, row[place] - amount)
    for place, amount in known.reserved:
        row[place] += amount
    return row


def _list_free_shares(fleet: Capacities, row: Sequence[float]) -> list[float]:
    return [
        compute_free_share(capacity, amount)
        for capacity, amount in zip(fleet.usable[CPU.name], row, strict=True)
    ]


def stays_within(
    known: KnownPlan, limits: StayLimits, used: Mapping[str, float], manager: ManagerState
) -> bool:
    """Whether the plan that `read_again` makes of these readings leaves all tasks where they run.

    False says nothing; so where moves have been measured, whose cost counts instead of the margin.
    """
    if any(len(seconds) >= MIN_DOWNTIME_SAMPLES for seconds in manager.downtimes.values()):
        return False
    return limits.hold(_list_free_shares(known.prepared.how.context.fleet, _count_cpu(known, used)))
