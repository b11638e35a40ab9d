"""Write demands into a task file in place: what stands between the values, comments, order and quotes, stays as it is."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple, NoReturn

from edgectl.config.problems import Code, Problems, Source, mark_of
from edgectl.config.spans import Span, content_end, spans
from edgectl.config.taskfields import MEASURED_WORD
from edgectl.errors import InputError


class Edit(NamedTuple):
    """``text`` in place of the characters from ``start`` to ``end``."""

    start: int
    end: int
    text: str


def with_demand(source: Source, task: str, amounts: Mapping[str, str]) -> str | None:
    """The text with the demands of an entry set to ``amounts``; None: the file has no such entry.

    ``source`` has been read without a mistake. What counts as measured goes on doing so: its amount is what counts until then.

    Raises:
        InputError: it stands where a change would reach further than meant, or where none can be made safely.
    """
    root = spans(source.text)
    tasks = root.entries.get("tasks")
    entry = tasks.entries.get(task) if tasks is not None else None
    if tasks is None or entry is None:
        return None
    editor = _Editor(source, amounts)
    for span in (root, tasks, entry):
        editor.own(span)
    text = source.text
    for edit in sorted(editor.edits(entry), reverse=True):
        text = text[: edit.start] + edit.text + text[edit.end :]
    return text


class _Editor:
    """The changes of one entry."""

    def __init__(self, source: Source, amounts: Mapping[str, str]) -> None:
        self.source, self.text, self.amounts = source, source.text, amounts

    def edits(self, entry: Span) -> Iterator[Edit]:
        demand = entry.entries.get("demand")
        if demand is None:
            yield self.added(entry, {"demand": _flow(self.amounts)})
            return
        self.own(demand)
        missing = {key: amount for key, amount in self.amounts.items() if key not in demand.entries}
        if self.text[demand.start : demand.end].strip("'\"") == MEASURED_WORD:
            until = {key: _flow({"until_measured": amount}) for key, amount in self.amounts.items()}
            left = {key: MEASURED_WORD for key in ("cpu", "memory", "throughput") if key not in until}
            yield Edit(demand.start, demand.end, _flow({**until, **left}))
            return
        for key in self.amounts.keys() - missing.keys():
            yield self.changed(demand.entries[key], self.amounts[key])
        if missing:
            yield self.added(demand, missing)

    def changed(self, span: Span, amount: str) -> Edit:
        self.own(span)
        if "until_measured" in span.entries:
            return self.changed(span.entries["until_measured"], amount)
        old = self.text[span.start : span.end]
        if "\n" in old or not old:
            self.refuse(span, "is written over several lines")
        if old.strip("'\"") == MEASURED_WORD:
            return Edit(span.start, span.end, _flow({"until_measured": amount}))
        quote = old[0] if old[0] in "'\"" else ""
        return Edit(span.start, span.end, f"{quote}{amount}{quote}")

    def added(self, mapping: Span, entries: Mapping[str, str]) -> Edit:
        """New keys behind the last one whose end can be told."""
        if not mapping.entries:
            if self.text[mapping.start : mapping.end].strip("{} \t") != "":
                self.refuse(mapping, "is empty but for comments")
            return Edit(mapping.start, mapping.end, _flow(entries))
        if not mapping.block:
            last = list(mapping.entries.values())[-1].end
            return Edit(last, last, "".join(f", {key}: {value}" for key, value in entries.items()))
        ends = [end for span in mapping.entries.values() if (end := content_end(span, self.text)) is not None]
        if not ends:
            self.refuse(mapping, "ends where only its indentation tells")
        at, newline = _line_end(self.text, ends[-1])
        return Edit(at, at, "".join(f"{newline}{' ' * mapping.column}{key}: {value}" for key, value in entries.items()))

    def own(self, span: Span) -> None:
        """Refuse what also stands elsewhere."""
        if span.shared:
            self.refuse(span, "has an anchor or is an alias, so a change would reach further")

    def refuse(self, span: Span, why: str) -> NoReturn:
        problems = Problems()
        end = self.text.find("\n", span.start)
        mark = mark_of(self.source, span.start, max(span.start + 1, min(span.end, end if end >= 0 else len(self.text))))
        problems.add(mark, Code.YAML_FEATURE, f"this {why}: it is not edited", f"write it by hand: demand: {_flow(self.amounts)}")
        raise InputError(problems.errors)


def _flow(entries: Mapping[str, str]) -> str:
    return "{" + ", ".join(f"{key}: {value}" for key, value in entries.items()) + "}"


def _line_end(text: str, offset: int) -> tuple[int, str]:
    """Where the line of ``offset`` ends, and how lines end there."""
    end = text.find("\n", offset)
    if end < 0:
        return len(text), "\r\n" if "\r\n" in text else "\n"
    return (end - 1, "\r\n") if text[end - 1] == "\r" else (end, "\n")
