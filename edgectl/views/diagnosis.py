"""What ``edgectl doctor`` found, host by host, as text and as a document."""

from edgectl.formats.base import FORMAT_VERSION, Document, without_none
from edgectl.model.finding import Diagnosis, Finding, Level
from edgectl.views.text import PLAIN, Cell, Look, Row, columns, harmless, paint

_STYLES = {Level.OK: "good", Level.WARNING: "warn", Level.FAILED: "bad"}
_MARKS = {Level.OK: "✓", Level.WARNING: "!", Level.FAILED: "✗"}
_WORDS = {Level.OK: "ok", Level.WARNING: "warn", Level.FAILED: "FAIL"}
_HERE = "this machine"
# Of the longest check, so that all hosts' columns stand under each other.
_CHECK_WIDTH = len("reachability")


def text(value: Diagnosis, look: Look = PLAIN) -> str:
    """One line per check, with what mends it below; one line that sums up."""
    hosts = dict.fromkeys(finding.host for finding in value.findings)
    return "\n".join([*(_group(host, value, look) for host in hosts), _summary(value, look)])


def _group(host: str | None, value: Diagnosis, look: Look) -> str:
    rows = [row for finding in value.findings if finding.host == host for row in _rows(finding, look)]
    return paint(harmless(host or _HERE), "bold", look) + "\n" + columns(rows, look)


def _rows(finding: Finding, look: Look) -> list[Row]:
    marks = _MARKS if look.unicode else _WORDS
    mark = Cell(f"{marks[finding.level]:<{max(map(len, marks.values()))}}", _STYLES[finding.level])
    row: Row = (mark, f"{finding.check:<{_CHECK_WIDTH}}", finding.message)
    return [row, ("", "", Cell(f"fix: {finding.mend}", "name"))] if finding.mend else [row]


def _summary(value: Diagnosis, look: Look) -> str:
    counts = value.counts
    total, failed, warned = len(value.findings), counts[Level.FAILED], counts[Level.WARNING]
    said = f"{total} checks: {failed} failed, {warned} warning{'' if warned == 1 else 's'}."
    return paint(said, _STYLES[value.worst], look) + "\n"


def document(value: Diagnosis) -> Document:
    """The findings as JSON types; ``host`` is null where this machine is meant."""
    return {
        "format_version": FORMAT_VERSION,
        "worst": value.worst.value,
        "counts": {level.value: count for level, count in value.counts.items()},
        "findings": [_document(finding) for finding in value.findings],
    }


def _document(finding: Finding) -> Document:
    found: Document = {"host": finding.host, "check": finding.check, "level": finding.level.value, "message": finding.message}
    return found | without_none(mend=finding.mend or None)
