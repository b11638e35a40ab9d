# SPDX-License-Identifier: Apache-2.0
"""Substitutions ``$(NAME WORD ..)`` of launch files: syntax, and replacement by a table of functions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from edgectl.config.problems import Mark, ProblemCode
from edgectl.importers.fault import ImportFaultError
from edgectl.names import format_name_list, suggest_name

MAX_DEPTH = 20
SubstitutionFunction: TypeAlias = Callable[[Sequence[str], Mark], str]


@dataclass(frozen=True, slots=True)
class Call:
    """One substitution; each word consists of text and further substitutions."""

    words: "tuple[tuple[str | Call, ...], ...]"
    start: int
    end: int


Template: TypeAlias = "tuple[str | Call, ...]"


def substitute(text: str, functions: Mapping[str, SubstitutionFunction], mark: Mark) -> str:
    """``text`` with every substitution replaced.

    Raises:
        ImportFaultError: a bracket is not closed, a substitution is unknown, or its function refuses it.
    """
    if "$(" not in text:
        return text
    parser = _Parser(text, mark)
    return _fill_template(parser.read_template(), functions, parser)


def _fill_template(
    template: Template, functions: Mapping[str, SubstitutionFunction], parser: "_Parser"
) -> str:
    return "".join(
        part if isinstance(part, str) else _fill_call(part, functions, parser) for part in template
    )


def _fill_call(call: Call, functions: Mapping[str, SubstitutionFunction], parser: "_Parser") -> str:
    words = [_fill_template(word, functions, parser) for word in call.words]
    mark = parser.mark_span(call.start, call.end)
    name = words[0] if words else ""
    if name not in functions:
        match = suggest_name(name, functions)
        raise ImportFaultError(
            mark,
            ProblemCode.SUBSTITUTION,
            f"unknown substitution $({name})" if name else "empty substitution $()",
            f"did you mean {match}?" if match else f"known are {format_name_list(sorted(functions))}",
        )
    return functions[name](words[1:], mark)


class _Parser:
    """Recursive descent over one attribute."""

    def __init__(self, text: str, mark: Mark) -> None:
        self.text, self.mark = text, mark
        self.place = 0
        self.depth = 0

    def mark_span(self, start: int, end: int) -> Mark:
        """The position of a span of the attribute, if it stands on its line as written."""
        line = self.mark.source.line(self.mark.line)
        column = self.mark.column + start
        if line[column - 1 : column - 1 + end - start] == self.text[start:end]:
            return Mark(self.mark.source, self.mark.line, column, end - start)
        return self.mark

    def read_template(self) -> Template:
        parts: list[str | Call] = []
        while self.place < len(self.text):
            if self.text.startswith("$(", self.place):
                parts.append(self.read_call())
            else:
                found = self.text.find("$(", self.place)
                stop = found if found >= 0 else len(self.text)
                parts.append(self.text[self.place : stop])
                self.place = stop
        return tuple(parts)

    def read_call(self) -> Call:
        start = self.place
        self.depth += 1
        self.place += 2
        words: list[Template] = []
        while self.place < len(self.text) and self.text[self.place] != ")" and self.depth <= MAX_DEPTH:
            if self.text[self.place].isspace():
                self.place += 1
            else:
                words.append(self.read_word())
        self.depth -= 1
        if self.place >= len(self.text) or self.text[self.place] != ")":
            message = "this substitution is not closed, or nested too deeply"
            raise ImportFaultError(
                self.mark_span(start, start + 2), ProblemCode.SUBSTITUTION, message, "close it with )"
            )
        self.place += 1
        return Call(tuple(words), start, self.place)

    def read_word(self) -> Template:
        parts: list[str | Call] = []
        quote = ""
        while self.place < len(self.text):
            char = self.text[self.place]
            if self.text.startswith("$(", self.place):
                parts.append(self.read_call())
                continue
            if not quote and (char.isspace() or char == ")"):
                break
            self.place += 1
            if char == quote:
                quote = ""
            elif not quote and char in "'\"":
                quote = char
            else:
                parts.append(char)
        return tuple(parts)
