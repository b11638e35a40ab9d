"""A plan as a comment on a pull request. The hidden marker lets a CI job edit its comment instead of adding one."""

from collections.abc import Sequence

from edgectl.model.evidence import Column
from edgectl.model.experiment import Run
from edgectl.model.plan import Plan, Step
from edgectl.views import sections
from edgectl.views.demands import demands
from edgectl.views.measured import markdown
from edgectl.views.reasons import reason
from edgectl.views.sections import figure
from edgectl.views.text import PLAIN, Look, harmless

MARKER = "<!-- edgectl-plan -->"
_HEAD = "| | task | now | next | utility | lead | reason |\n|---|---|---|---|---:|---:|---|\n"
_SPECIAL = str.maketrans({character: f"\\{character}" for character in "\\`*_[]<>|#~"})


def plan(value: Plan, _look: Look = PLAIN) -> str:
    """The table form in Markdown; the expected load and the demands folded away."""
    rows = "".join(_row(step) for step in value.steps)
    load = sections.expected(value).replace("```", "'''")
    folded = _folded("Expected load", load) + _folded("Demands", demands(value).replace("```", "'''"))
    notes = "".join(f"\n> {_plain(line)}\n" for line in sections.notes(value).splitlines())
    return f"{MARKER}\n**{sections.summary(value).strip()}**\n\n{_HEAD}{rows}{notes}{folded}\n{sections.header(value)}"


def measured(run: Run, values: Sequence[Column], _look: Look = PLAIN) -> str:
    """The wide table of an experiment."""
    return markdown(run, values, _plain)


def _folded(title: str, text: str) -> str:
    return f"\n<details><summary>{title}</summary>\n\n```text\n{text}```\n\n</details>\n" if text else ""


def _row(step: Step) -> str:
    decision = step.decision
    fields = (
        step.task,
        decision.previous_host or "-",
        decision.host or "-",
        figure(decision.total),
        figure(decision.lead, signed=True),
        reason(step),
    )
    return f"| `{step.action.symbol}` | " + " | ".join(_plain(field) for field in fields) + " |\n"


def _plain(text: str) -> str:
    return harmless(text).translate(_SPECIAL)
