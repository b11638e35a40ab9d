# SPDX-License-Identifier: Apache-2.0
"""Problems in input files: stable codes, positions, and their collection."""

import re
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable
from dataclasses import field, replace
from enum import StrEnum
from functools import lru_cache

from edgectl.dataclass import dataclass
from edgectl.errors import InputError, Problem
from edgectl.names import format_name_list, suggest_name

_MAX_LINE_LENGTH = 400
_MAX_MESSAGE_LENGTH = 300
_MAX_SUGGESTIONS = 50
# Of errors, and of warnings: a file of 1 MiB can have a hundred thousand.
_MAX_PROBLEMS = 100
_SECRET_MARGIN_LINES = 3
_SECRET_PATTERN = re.compile(r"\b(secret|value)\W*:")


class ProblemCode(StrEnum):
    """Stable codes of problems; from EC101 on warnings, from EC201 on about JSON documents."""

    UNREADABLE = "EC001"
    ENCODING = "EC002"
    SIZE = "EC003"
    SYNTAX = "EC004"
    DUPLICATE_KEY = "EC005"
    YAML_FEATURE = "EC006"
    BUDGET = "EC007"
    EMPTY = "EC008"
    TYPE = "EC010"
    MISSING = "EC011"
    UNKNOWN_KEY = "EC012"
    WORD = "EC013"
    NAME = "EC014"
    QUANTITY = "EC015"
    VERSION = "EC016"
    REGEX = "EC017"
    PASSWORD = "EC018"  # noqa: S105 - a code, not a password
    TEXT = "EC019"
    UNKNOWN_NAME = "EC030"
    CYCLE = "EC031"
    TAKEN = "EC032"
    CONTRADICTION = "EC033"
    TOO_MANY = "EC034"
    PLACEHOLDER = "EC035"
    ELEMENT = "EC040"
    SUBSTITUTION = "EC041"
    INCLUDE = "EC042"
    PYTHON = "EC043"
    NO_DEMAND = "EC101"
    NEVER_ANSWERED = "EC102"
    UNNAMED_FLEET = "EC103"
    EXPOSED = "EC104"
    NO_IDENTITY_FILE = "EC105"
    BACKGROUND = "EC106"
    NOT_IMPORTED = "EC107"
    ROS = "EC108"
    JSON = "EC201"
    DOCUMENT = "EC202"


# reported once per position, whatever the words: a template's mistake is not repeated for every robot
_ONCE_PER_PLACE = (
    ProblemCode.CONTRADICTION,
    ProblemCode.PLACEHOLDER,
    ProblemCode.NEVER_ANSWERED,
    ProblemCode.BACKGROUND,
    ProblemCode.ROS,
    ProblemCode.CYCLE,
    ProblemCode.NAME,
)


# Codes whose messages and hints quote the text at the position.
_QUOTING_CODES = (ProblemCode.ENCODING, ProblemCode.SYNTAX, ProblemCode.YAML_FEATURE)
# Names the warnings that a file is to be read without.
_IGNORE_COMMENT = re.compile(r"#\s*edgectl:\s*ignore\s+(EC\d{3}(?:[\s,]+EC\d{3})*)")
_REDACTED_MESSAGE = "cannot be read; the text is hidden because a secret is near"


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Text of one file: ``file`` as the user named it, ``lines`` without line ends."""

    file: str
    text: str
    lines: tuple[str, ...]

    def line(self, number: int) -> str:
        """The line (from 1); empty if it is missing, too long to show, or may contain a secret."""
        line = self.lines[number - 1] if 0 < number <= len(self.lines) else ""
        return "" if len(line) > _MAX_LINE_LENGTH or _SECRET_PATTERN.search(line) else line

    def is_near_secret(self, number: int) -> bool:
        """Whether a secret may be on the line or next to it."""
        return any(
            _SECRET_PATTERN.search(line)
            for line in self.lines[max(0, number - 1 - _SECRET_MARGIN_LINES) : number + _SECRET_MARGIN_LINES]
        )


@dataclass(frozen=True, slots=True)
class Mark:
    """A position in a file: line and column count from 1; ``length`` is the width of the caret."""

    source: Source
    line: int
    column: int
    length: int = 1

    def redact(self) -> "Mark":
        """The same position with its line hidden."""
        return Mark(Source(file=self.source.file, text="", lines=()), self.line, self.column, self.length)


def mark_from_span(source: Source, start: int, end: int) -> Mark:
    """The position of a span of the text (offsets in characters)."""
    starts = _list_line_starts(source.text)
    line = bisect_right(starts, start)
    return Mark(source, line, start - starts[line - 1] + 1, end - start)


@lru_cache(maxsize=1)
def _list_line_starts(text: str) -> tuple[int, ...]:
    """The offset of each line; kept, because a file of one fault may have a hundred thousand of it."""
    return (0, *(found.end() for found in re.finditer("\n", text)))


@dataclass(slots=True)
class Problems:
    """The problems found so far, each once: the first errors and warnings, and the number of the others."""

    found: list[Problem] = field(default_factory=list)
    _omitted: Counter[bool] = field(default_factory=Counter)
    _count: Counter[bool] = field(default_factory=Counter)
    _seen: set[tuple[str, int, int, str, str]] = field(default_factory=set)
    _suggested: int = 0

    def add(
        self, mark: Mark, code: ProblemCode, message: str, hint: str = "", *, warning: bool = False
    ) -> None:
        """Add a problem at ``mark``."""
        key = (
            mark.source.file,
            mark.line,
            mark.column,
            code.value,
            "" if code in _ONCE_PER_PLACE else message,
        )
        if key in self._seen or (warning and _is_ignored(mark, code)):
            return
        self._seen.add(key)
        # Who may write a file decides what is done with it, so that is never left out.
        if self._count[warning] >= _MAX_PROBLEMS and code is not ProblemCode.EXPOSED:
            self._omitted[warning] += 1
            return
        self._count[warning] += 1
        unseen = code in _QUOTING_CODES and mark.source.is_near_secret(mark.line)
        if unseen:
            message, hint = (
                _REDACTED_MESSAGE,
                "check the quotes, brackets, colons and the indentation of this entry",
            )
        self.found.append(
            Problem(
                file=mark.source.file,
                line=mark.line,
                column=mark.column,
                code=code.value,
                message=to_one_line(message),
                hint=to_one_line(hint),
                source="" if unseen else mark.source.line(mark.line),
                length=max(1, min(mark.length, _MAX_LINE_LENGTH)),
                warning=warning,
            )
        )

    def did_you_mean(self, word: str, known: Iterable[str], otherwise: str = "known are") -> str:
        """Hint for an unknown word: the nearest known one, or the list of them.

        The search takes time, so after the first ``_MOST_SUGGESTIONS`` only the list is given.
        """
        words = list(known)
        self._suggested += 1
        match = suggest_name(word, words) if self._suggested <= _MAX_SUGGESTIONS else ""
        if match:
            return f"did you mean {match}?"
        return f"{otherwise} {format_name_list(words)}" if words else ""

    @property
    def errors(self) -> tuple[Problem, ...]:
        """Problems that make the files unusable, by file, line and column."""
        return self._list_problems(warning=False)

    @property
    def warnings(self) -> tuple[Problem, ...]:
        """Warnings: legal but suspicious."""
        return self._list_problems(warning=True)

    def _list_problems(self, *, warning: bool) -> tuple[Problem, ...]:
        listed = sorted((each for each in self.found if each.warning is warning), key=_build_sort_key)
        if not self._omitted[warning]:
            return tuple(listed)
        others = replace(
            listed[-1], message=f"and {self._omitted[warning]} more", hint="correct the first ones"
        )
        return (*listed, others)

    def check(self) -> None:
        """End of reading.

        Raises:
            InputError: there are errors; it carries the warnings, too, after the errors.
        """
        if self.errors:
            raise InputError((*self.errors, *self.warnings))


def _is_ignored(mark: Mark, code: ProblemCode) -> bool:
    """Whether a comment on the line, or one that fills the line above, silences this warning.

    What others may write is no matter of taste: that warning stays.
    """
    if code is ProblemCode.EXPOSED:
        return False
    here, above = (
        mark.source.lines[number - 1] if 0 < number <= len(mark.source.lines) else ""
        for number in (mark.line, mark.line - 1)
    )
    comments = (here, above if above.lstrip().startswith("#") else "")
    found = (_IGNORE_COMMENT.search(text) for text in comments)
    return any(each is not None and code.value in each[1].replace(",", " ").split() for each in found)


def _build_sort_key(problem: Problem) -> tuple[str, int, int, str]:
    return problem.file, problem.line, problem.column, problem.code


def to_one_line(text: str) -> str:
    """``text`` on one line of bounded length, with control characters removed."""
    cut = text if len(text) <= _MAX_MESSAGE_LENGTH else text[: _MAX_MESSAGE_LENGTH - 2] + ".."
    return "".join(char if char.isprintable() else repr(char)[1:-1] for char in cut)
