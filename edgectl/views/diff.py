# SPDX-License-Identifier: Apache-2.0
"""Differences between what runs and what a plan would have run."""

from collections.abc import Iterator, Sequence

from edgectl.formats.document import Document
from edgectl.model.plan import Action, Plan, Step
from edgectl.model.standby_plan import StandbyAction
from edgectl.views.output import ListView
from edgectl.views.output_format import NAMED_FORMATS
from edgectl.views.plan_sections import list_plan_notes
from edgectl.views.reasons import describe_reason
from edgectl.views.text import PLAIN, RenderOptions, escape_unprintable, style_text

_STYLES = {"-": "bad", "+": "good", "@": "dim"}


class DiffView(ListView):
    """Each task that an apply would change, as a unified diff of places: ``-`` runs now, ``+`` would run."""

    kind = "difference"
    formats = NAMED_FORMATS

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._steps = [step for step in plan.steps if step.changes]

    def table(self, look: RenderOptions = PLAIN) -> str:
        """Nothing where nothing differs."""
        if not self._steps:
            return ""
        lines = ["--- running", "+++ planned", *(line for step in self._steps for line in _list_lines(step))]
        return "".join(style_text(escape_unprintable(line), _STYLES[line[0]], look) + "\n" for line in lines)

    def warnings(self) -> Sequence[str]:
        """The remarks of the plan."""
        return list_plan_notes(self._plan)

    def items(self) -> Sequence[Document]:
        """The tasks that differ as JSON types."""
        return [
            {
                "task": step.task,
                "action": step.action.value,
                "reason": describe_reason(step),
                "previous_host": step.decision.previous_host,
                "host": step.decision.host,
                "lines": [line for line in _list_lines(step) if line[0] != "@"],
            }
            for step in self._steps
        ]

    def names(self) -> Sequence[str]:
        """The tasks that differ."""
        return [f"task/{step.task}" for step in self._steps]


def _list_lines(step: Step) -> Iterator[str]:
    """A heading with the reason, then the places that are left and those that are taken."""
    task, decision = step.task, step.decision
    yield f"@@ {task}: {describe_reason(step)} @@"
    left = dict.fromkeys([*step.stop, *(step.instances if step.action.changes else ())])
    if step.action in (Action.MOVE, Action.RESTART, Action.STOP, Action.COMPLETE) and decision.previous_host:
        left[decision.previous_host] = None
    yield from (f"-{task} on {host}" for host in left)
    yield from (
        f"-{task} standby on {each.host}" for each in step.standbys if each.action is StandbyAction.STOP
    )
    if step.action in (Action.START, Action.MOVE, Action.RESTART, Action.ADOPT) and decision.host:
        changed = f" ({', '.join(step.changed)} changed)" if step.changed not in ((), ("spec",)) else ""
        yield f"+{task} on {decision.host}{changed}"
    yield from (
        f"+{task} standby on {each.host}"
        for each in step.standbys
        if each.action.changes and each.action is not StandbyAction.STOP
    )
