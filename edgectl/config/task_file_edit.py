# SPDX-License-Identifier: Apache-2.0
"""Edits of YAML text in place: exact positions of values, and replacement of the demands of an entry."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, NoReturn, TypeAlias

from edgectl.config.demand_readers import MEASURED_WORD
from edgectl.config.problems import ProblemCode, Problems, Source, mark_from_span
from edgectl.config.yaml_library import EVENT_PARSER, yaml
from edgectl.errors import InputError
from edgectl.model.resource import TASK_RESOURCES

YamlEvent: TypeAlias = Any  # the stubs do not declare the attributes of the parser's events


@dataclass(slots=True, eq=False)
class YamlSpan:
    """One value: ``start`` and ``end`` are offsets into the text; block mappings and lists end where the next
    value begins.

    ``block``: delimited by indentation, at ``column``. ``shared``: it has an anchor or is an alias, so it
    also applies elsewhere.
    """

    start: int
    end: int
    column: int = 0
    block: bool = False
    shared: bool = False
    entries: "dict[str, YamlSpan]" = field(default_factory=dict)
    items: "list[YamlSpan]" = field(default_factory=list)


def parse_spans(text: str) -> YamlSpan:
    """The value of a document that was read without problems."""
    events = yaml.parse(text, Loader=EVENT_PARSER)
    next(events)
    next(events)
    return _build_span(next(events), events)


def _build_span(event: YamlEvent, events: Iterator[YamlEvent]) -> YamlSpan:
    mark = event.start_mark
    span = YamlSpan(mark.index, event.end_mark.index, column=mark.column, shared=event.anchor is not None)
    if isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
        span.block = not event.flow_style
        _fill_span(span, events, mapping=isinstance(event, yaml.MappingStartEvent))
    return span


def _fill_span(span: YamlSpan, events: Iterator[YamlEvent], *, mapping: bool) -> None:
    for event in events:
        if type(event) in (yaml.MappingEndEvent, yaml.SequenceEndEvent):
            span.end = event.end_mark.index
            return
        if mapping:
            span.entries[event.value] = _build_span(next(events), events)
        else:
            span.items.append(_build_span(event, events))


def find_content_end(span: YamlSpan, text: str) -> int | None:
    """End of a value without trailing comments and blanks; None for a block scalar, which ends by
    indentation.
    """
    inner = list(span.entries.values()) or span.items
    if span.block and inner:
        return find_content_end(inner[-1], text)
    return None if text[span.start : span.start + 1] in ("|", ">") else span.end


class TextEdit(NamedTuple):
    """``text`` replaces the characters from ``start`` to ``end``."""

    start: int
    end: int
    text: str


def edit_demand(source: Source, task: str, amounts: Mapping[str, str]) -> str | None:
    """The text with the demands of an entry set to ``amounts``; None: the file has no such entry.

    ``source`` was read without problems. Measured demands stay measured: their amount applies until enough is
    measured.

    Raises:
        InputError: a change would apply elsewhere too, or cannot be made safely.
    """
    root = parse_spans(source.text)
    tasks = root.entries.get("tasks")
    entry = tasks.entries.get(task) if tasks is not None else None
    if tasks is None or entry is None:
        return None
    editor = _DemandEditor(source, amounts)
    for span in (root, tasks, entry):
        editor.own(span)
    text = source.text
    for edit in sorted(editor.edits(entry), reverse=True):
        text = text[: edit.start] + edit.text + text[edit.end :]
    return text


class _DemandEditor:
    """The changes of one entry."""

    def __init__(self, source: Source, amounts: Mapping[str, str]) -> None:
        self.source, self.text, self.amounts = source, source.text, amounts

    def edits(self, entry: YamlSpan) -> Iterator[TextEdit]:
        demand = entry.entries.get("demand")
        if demand is None:
            yield self.added(entry, {"demand": _format_flow_mapping(self.amounts)})
            return
        self.own(demand)
        missing = {key: amount for key, amount in self.amounts.items() if key not in demand.entries}
        if self.text[demand.start : demand.end].strip("'\"") == MEASURED_WORD:
            until = {
                key: _format_flow_mapping({"until_measured": amount}) for key, amount in self.amounts.items()
            }
            keys = (resource.demand_key for resource in TASK_RESOURCES)
            left = {key: MEASURED_WORD for key in keys if key not in until}
            yield TextEdit(demand.start, demand.end, _format_flow_mapping({**until, **left}))
            return
        for key in self.amounts.keys() - missing.keys():
            yield self.changed(demand.entries[key], self.amounts[key])
        if missing:
            yield self.added(demand, missing)

    def changed(self, span: YamlSpan, amount: str) -> TextEdit:
        self.own(span)
        if "until_measured" in span.entries:
            return self.changed(span.entries["until_measured"], amount)
        old = self.text[span.start : span.end]
        if "\n" in old or not old:
            self.refuse(span, "spans several lines")
        if old.strip("'\"") == MEASURED_WORD:
            return TextEdit(span.start, span.end, _format_flow_mapping({"until_measured": amount}))
        quote = old[0] if old[0] in "'\"" else ""
        return TextEdit(span.start, span.end, f"{quote}{amount}{quote}")

    def added(self, mapping: YamlSpan, entries: Mapping[str, str]) -> TextEdit:
        """New keys after the last one with a known end."""
        if not mapping.entries:
            if self.text[mapping.start : mapping.end].strip("{} \t") != "":
                self.refuse(mapping, "is empty except for comments")
            return TextEdit(mapping.start, mapping.end, _format_flow_mapping(entries))
        if not mapping.block:
            last = list(mapping.entries.values())[-1].end
            return TextEdit(last, last, "".join(f", {key}: {value}" for key, value in entries.items()))
        ends = [
            end for span in mapping.entries.values() if (end := find_content_end(span, self.text)) is not None
        ]
        if not ends:
            self.refuse(mapping, "ends only by its indentation")
        at, newline = _find_line_end(self.text, ends[-1])
        return TextEdit(
            at,
            at,
            "".join(f"{newline}{' ' * mapping.column}{key}: {value}" for key, value in entries.items()),
        )

    def own(self, span: YamlSpan) -> None:
        """Reject values that also apply elsewhere."""
        if span.shared:
            self.refuse(span, "has an anchor or is an alias, so a change would apply elsewhere, too")

    def refuse(self, span: YamlSpan, why: str) -> NoReturn:
        problems = Problems()
        end = self.text.find("\n", span.start)
        mark = mark_from_span(
            self.source, span.start, max(span.start + 1, min(span.end, end if end >= 0 else len(self.text)))
        )
        problems.add(
            mark,
            ProblemCode.YAML_FEATURE,
            f"this {why}: it is not edited",
            f"edit it by hand: demand: {_format_flow_mapping(self.amounts)}",
        )
        raise InputError(problems.errors)


def _format_flow_mapping(entries: Mapping[str, str]) -> str:
    return "{" + ", ".join(f"{key}: {value}" for key, value in entries.items()) + "}"


def _find_line_end(text: str, offset: int) -> tuple[int, str]:
    """End of the line at ``offset``, and its line ending."""
    end = text.find("\n", offset)
    if end < 0:
        return len(text), "\r\n" if "\r\n" in text else "\n"
    return (end - 1, "\r\n") if text[end - 1] == "\r" else (end, "\n")
