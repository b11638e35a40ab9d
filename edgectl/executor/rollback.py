"""A plan towards an old placement. Pure."""

import dataclasses
from collections.abc import Iterator, Mapping

from edgectl.executor.manual import running
from edgectl.model.assignment import Decision, Reason, Verdict
from edgectl.model.plan import Action, Plan, Step


def towards(plan: Plan, wanted: Mapping[str, str], revision: int) -> Plan:
    """``plan``, in which every task of ``wanted`` was held to its old host, without the tasks that did not run then.

    Of those, what runs now is stopped; what does not is left out.
    """
    places = running(plan.snapshot)
    steps = (step for step in plan.steps for step in _towards(step, wanted, places.get(step.task, {}), revision))
    return dataclasses.replace(plan, steps=tuple(steps))


def _towards(step: Step, wanted: Mapping[str, str], places: Mapping[str, str], revision: int) -> Iterator[Step]:
    decision = step.decision
    if step.task in wanted or decision.reason is Reason.UNMANAGED or decision.verdict in (Verdict.COMPLETED, Verdict.HELD):
        asked = step.action in (Action.START, Action.MOVE) and decision.host == wanted.get(step.task)
        reason = dataclasses.replace(decision, reason=Reason.ROLLBACK, amount=float(revision)) if asked else decision
        yield dataclasses.replace(step, decision=reason)
    elif places:
        left = Decision(
            task=step.task, verdict=Verdict.UNPLACED, reason=Reason.ROLLBACK, previous_host=next(iter(places)), amount=float(revision)
        )
        yield Step(decision=left, action=Action.STOP, instances=places)
