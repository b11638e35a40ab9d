"""The scheduler: (Inventory, Tasks, Snapshot, Memory, Policy, now) -> Assignment. Pure, and the same bytes for the same inputs."""

from dataclasses import replace

from edgectl.model.assignment import Assignment
from edgectl.model.inventory import Inventory
from edgectl.model.memory import Memory
from edgectl.model.policy import Policy, PolicyName
from edgectl.model.snapshot import Snapshot
from edgectl.model.task import Tasks
from edgectl.model.weights import normalised
from edgectl.scheduler.choice import Choice
from edgectl.scheduler.cost import handoffs_of
from edgectl.scheduler.fleet import fleet_of
from edgectl.scheduler.passes import Outcome, Pass, after, moved, run
from edgectl.scheduler.policies import RULES
from edgectl.scheduler.rho import with_history
from edgectl.scheduler.scan import shares_of
from edgectl.scheduler.sequence import sequence
from edgectl.scheduler.uneven import uneven
from edgectl.scheduler.view import Setting
from edgectl.scheduler.world import World, world_of

# How many passes may be tried before a plan counts as one that does not settle (DESIGN 5.10).
PASSES = 5


def assign(inventory: Inventory, tasks: Tasks, snapshot: Snapshot, memory: Memory, policy: Policy, now: float) -> Assignment:
    """A host, numbers and a reason for each task, in sequence order (Section IV of the paper; DESIGN section 5).

    ``now``: seconds since 1970, on the clock of ``snapshot.taken_at``.

    Raises:
        ValueError: the tasks' needs form a cycle, or the weights are not usable (both are errors of the files, found by validation).
    """
    used = replace(policy, weights=normalised(policy.weights))
    fleet = with_history(fleet_of(inventory, snapshot, memory, used.without), tasks, memory)
    world = world_of(tasks, memory, fleet, now)
    setting = Setting(fleet=fleet, policy=used, shares=shares_of(fleet), now=now, first=_first(memory, world), handoffs=handoffs_of(memory))
    order = sequence(tasks.tasks.values(), used.sequence)
    how = Pass(setting=setting, order=order, rule=RULES[used.name], origin=world, letter=used.name is PolicyName.PAPER)
    outcome, settled = _settle(how, world) if used.name is PolicyName.UTILITY else _once(how, world)
    return Assignment(
        policy=used,
        decisions=outcome.decisions,
        expected=outcome.ledger.expected({place for place, _ in outcome.placed.values()}),
        settled=settled,
        frozen=world.frozen,
        unseen=world.unseen,
        uneven=uneven(fleet, tasks),
    )


def _first(memory: Memory, world: World) -> dict[str, str]:
    """First placements, without those of tasks that leave theirs because it is silent (ADR 0023)."""
    return {task: host for task, host in memory.first.items() if task not in world.replaced}


def _settle(how: Pass, origin: World) -> tuple[Outcome, bool]:
    """The first of five passes that its repetition does not change; else one without voluntary moves.

    The first pass is recorded at once, because most plans stand at once; a later one only when it is known to be the one.
    """
    recorded = replace(how, record=True)
    world = origin
    carried: dict[str, Choice] = {}
    outcome = run(recorded, world, carried)
    for _ in range(PASSES):
        put = moved(outcome, carried, origin)
        next_world = after(world, outcome, origin)
        repeated = run(how, next_world, put)
        if repeated.places == outcome.places:
            return outcome if world is origin else run(recorded, world, carried), True
        world, carried, outcome = next_world, put, repeated
    return run(replace(recorded, voluntary=False), origin, {}), False


def _once(how: Pass, origin: World) -> tuple[Outcome, bool]:
    """One pass, and whether its repetition would change it."""
    outcome = run(replace(how, record=True), origin, {})
    return outcome, run(how, after(origin, outcome, origin), moved(outcome, {}, origin)).places == outcome.places
