# SPDX-License-Identifier: Apache-2.0
"""Manual pages in roff, from the parts of a command's help (pure)."""

from collections.abc import Iterable, Sequence

from edgectl.dataclass import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class ManPage:
    """One page: ``words`` of the command, its usage, text, options and examples; ``others``: pages to see."""

    words: str
    summary: str
    usage: str
    text: str
    options: Sequence[tuple[str, str]] = ()
    examples: Sequence[str] = ()
    others: Sequence[str] = ()

    @property
    def name(self) -> str:
        """Name of the page: ``edgectl-plan``."""
        return self.words.replace(" ", "-")


def render_man_page(page: ManPage, version: str, notes: Sequence[tuple[str, str]]) -> str:
    """The page in section 1; ``notes`` are further sections that stand in each page."""
    lines = [
        f'.TH "{page.name.upper()}" 1 "" "edgectl {_escape(version)}" "edgectl"',
        ".nh",
        ".SH NAME",
        f"{_escape(page.name)} \\- {_escape(page.summary.rstrip('.'))}",
        ".SH SYNOPSIS",
        f".B {_escape(page.usage)}",
        ".SH DESCRIPTION",
        *_render_paragraphs(page.text),
    ]
    if page.options:
        lines.append(".SH OPTIONS")
        for names, meaning in page.options:
            lines += [".TP", f".B {_escape(names)}", _render_line(meaning)]
    if page.examples:
        lines += [".SH EXAMPLES", ".nf", *(_render_line(line.strip()) for line in page.examples), ".fi"]
    for title, text in notes:
        lines += [f".SH {title}", *_render_paragraphs(text)]
    if page.others:
        references = ", ".join(f"\\fB{_escape(name)}\\fR(1)" for name in page.others)
        lines += [".SH SEE ALSO", references]
    return "\n".join(lines) + "\n"


def _render_paragraphs(text: str) -> Iterable[str]:
    for number, part in enumerate(text.strip().split("\n\n")):
        if number:
            yield ".PP"
        yield _render_line(" ".join(part.split()))


def _render_line(text: str) -> str:
    """A line of text, which roff does not take for a request."""
    escaped = _escape(text)
    return f"\\&{escaped}" if escaped.startswith((".", "'")) else escaped


def _escape(text: str) -> str:
    return text.replace("\\", "\\e").replace("-", "\\-")
