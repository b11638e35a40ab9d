"""Where the values of a YAML text stand, to the character: what an edit in place needs, and reading does not."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import yaml

from edgectl.config.yaml12 import LOADER

Event: TypeAlias = Any  # the stubs of the parser's events do not know which attributes are there


@dataclass(slots=True, eq=False)
class Span:
    """One value: ``start`` and ``end`` are offsets into the text; those of a block mapping or list end where the next value begins.

    ``block``: it is held together by indentation, at ``column``. ``shared``: it has an anchor or is an alias, so that it also stands
    elsewhere. ``entries``: of a mapping; ``items``: of a list.
    """

    start: int
    end: int
    column: int = 0
    block: bool = False
    shared: bool = False
    entries: "dict[str, Span]" = field(default_factory=dict)
    items: "list[Span]" = field(default_factory=list)


def spans(text: str) -> Span:
    """The one value of a document that has been read without a mistake."""
    events = yaml.parse(text, Loader=LOADER)
    next(events)
    next(events)
    return _span(next(events), events)


def _span(event: Event, events: Iterator[Event]) -> Span:
    mark = event.start_mark
    span = Span(mark.index, event.end_mark.index, column=mark.column, shared=event.anchor is not None)
    if isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
        span.block = not event.flow_style
        _fill(span, events, mapping=isinstance(event, yaml.MappingStartEvent))
    return span


def _fill(span: Span, events: Iterator[Event], *, mapping: bool) -> None:
    for event in events:
        if type(event) in (yaml.MappingEndEvent, yaml.SequenceEndEvent):
            span.end = event.end_mark.index
            return
        if mapping:
            span.entries[event.value] = _span(next(events), events)
        else:
            span.items.append(_span(event, events))


def content_end(span: Span, text: str) -> int | None:
    """Where the last character of a value stands that is no comment and no blank; None: of a block scalar, which ends by indentation."""
    inner = list(span.entries.values()) or span.items
    if span.block and inner:
        return content_end(inner[-1], text)
    return None if text[span.start : span.start + 1] in ("|", ">") else span.end
