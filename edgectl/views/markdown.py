"""A plan as a comment on a pull request. The hidden marker lets a CI job edit its comment instead of adding one."""

from edgectl.model.plan import Plan, Step
from edgectl.views import plan_sections
from edgectl.views.demands import render_demands
from edgectl.views.plan_sections import format_utility
from edgectl.views.reasons import describe_reason
from edgectl.views.text import PLAIN, RenderOptions, escape_unprintable

PLAN_COMMENT_MARKER = "<!-- edgectl-plan -->"
_TABLE_HEAD = "| | task | now | next | utility | lead | reason |\n|---|---|---|---|---:|---:|---|\n"
_MARKDOWN_ESCAPES = str.maketrans({character: f"\\{character}" for character in "\\`*_[]<>|#~"})


def plan(value: Plan, _look: RenderOptions = PLAIN) -> str:
    """The table form in Markdown; the expected load and the demands folded away."""
    rows = "".join(_render_markdown_row(step) for step in value.steps)
    load = plan_sections.render_expected_load(value).replace("```", "'''")
    folded = _render_folded_section("Expected load", load) + _render_folded_section(
        "Demands", render_demands(value).replace("```", "'''")
    )
    notes = "".join(
        f"\n> {escape_markdown(line)}\n" for line in plan_sections.render_plan_notes(value).splitlines()
    )
    return f"{PLAN_COMMENT_MARKER}\n**{plan_sections.render_plan_summary(value).strip()}**\n\n{_TABLE_HEAD}{rows}{notes}{folded}\n{plan_sections.render_plan_header(value)}"


def _render_folded_section(title: str, text: str) -> str:
    return f"\n<details><summary>{title}</summary>\n\n```text\n{text}```\n\n</details>\n" if text else ""


def _render_markdown_row(step: Step) -> str:
    decision = step.decision
    fields = (
        step.task,
        decision.previous_host or "-",
        decision.host or "-",
        format_utility(decision.total),
        format_utility(decision.lead, signed=True),
        describe_reason(step),
    )
    return f"| `{step.action.symbol}` | " + " | ".join(escape_markdown(field) for field in fields) + " |\n"


def escape_markdown(text: str) -> str:
    """``text`` as it stands in Markdown, without markup and control characters."""
    return escape_unprintable(text).translate(_MARKDOWN_ESCAPES)
