# SPDX-License-Identifier: Apache-2.0
"""Findings of ``edgectl doctor``, host by host."""

import platform
from collections.abc import Sequence

from edgectl import __version__
from edgectl.formats.document import Document, without_none
from edgectl.model.diagnosis import Diagnosis, Finding, Severity
from edgectl.views.output import ListView
from edgectl.views.output_format import DIAGNOSIS_FORMATS
from edgectl.views.plan import escape_markdown
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, escape_unprintable, render_columns, style_text

_LEVEL_STYLES = {Severity.OK: "good", Severity.WARNING: "warn", Severity.FAILED: "bad"}
_LEVEL_MARKS = {Severity.OK: "✓", Severity.WARNING: "!", Severity.FAILED: "✗"}
_LEVEL_WORDS = {Severity.OK: "ok", Severity.WARNING: "warn", Severity.FAILED: "FAIL"}
_THIS_MACHINE = "this machine"
# Of the longest check, so that all hosts' columns stand under each other.
_CHECK_WIDTH = len("reachability")


class DiagnosisView(ListView):
    """The finding of each check."""

    kind = "finding"
    formats = DIAGNOSIS_FORMATS

    def __init__(self, diagnosis: Diagnosis) -> None:
        self._diagnosis = diagnosis

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per check with its remedy below, and a line that counts."""
        value = self._diagnosis
        hosts = dict.fromkeys(finding.host for finding in value.findings)
        parts = [_render_host_findings(host, value, look) for host in hosts]
        return "\n".join([*parts, _render_diagnosis_summary(value, look)])

    def markdown(self) -> str:
        """A report to paste into an issue: the versions, and what is not in order; the rest folded away."""
        worst = [each for each in self._diagnosis.findings if each.level is not Severity.OK]
        versions = f"edgectl {__version__}, Python {platform.python_version()}, {platform.platform()}"
        lines = [
            f"- **{each.host or _THIS_MACHINE}**: {escape_markdown(_describe_finding(each))}"
            for each in worst
        ]
        whole = self.table().replace("```", "'''")
        return (
            "\n".join([versions, "", *(lines or ["Nothing is wrong."])])
            + f"\n\n<details><summary>All checks</summary>\n\n```\n{whole}```\n\n</details>\n"
        )

    def items(self) -> Sequence[Document]:
        """The findings as JSON types; ``host`` is null where the manager's machine is meant."""
        return [_encode_finding(finding) for finding in self._diagnosis.findings]


def _describe_finding(finding: Finding) -> str:
    fix = f" (fix: {finding.remedy})" if finding.remedy else ""
    return f"{_LEVEL_WORDS[finding.level]} {finding.check}: {finding.message}{fix}"


def _render_host_findings(host: str | None, value: Diagnosis, look: RenderOptions) -> str:
    rows = [
        row
        for finding in value.findings
        if finding.host == host
        for row in _render_finding_rows(finding, look)
    ]
    return (
        style_text(escape_unprintable(host or _THIS_MACHINE), "bold", look)
        + "\n"
        + render_columns(rows, look)
    )


def _render_finding_rows(finding: Finding, look: RenderOptions) -> list[Row]:
    marks = _LEVEL_MARKS if look.unicode else _LEVEL_WORDS
    mark = Cell(f"{marks[finding.level]:<{max(map(len, marks.values()))}}", _LEVEL_STYLES[finding.level])
    row: Row = (mark, f"{finding.check:<{_CHECK_WIDTH}}", finding.message)
    return [row, ("", "", Cell(f"fix: {finding.remedy}", "name"))] if finding.remedy else [row]


def _render_diagnosis_summary(value: Diagnosis, look: RenderOptions) -> str:
    counts = value.counts
    total, failed, warned = len(value.findings), counts[Severity.FAILED], counts[Severity.WARNING]
    said = f"{total} checks: {failed} failed, {warned} warning{'' if warned == 1 else 's'}."
    return style_text(said, _LEVEL_STYLES[value.worst], look) + "\n"


def _encode_finding(finding: Finding) -> Document:
    found: Document = {
        "host": finding.host,
        "check": finding.check,
        "level": finding.level.value,
        "message": finding.message,
    }
    return found | without_none(hint=finding.remedy or None)
