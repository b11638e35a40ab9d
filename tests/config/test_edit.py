# SPDX-License-Identifier: Apache-2.0
"""Writing demands into a task file: the demand of one entry changes, and nothing else."""

import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edgectl.config.load import load_inventory_and_tasks
from edgectl.config.problems import Source
from edgectl.config.task_file_edit import YamlSpan, edit_demand, parse_spans
from edgectl.errors import InputError
from edgectl.model.demand import Demand, Quantity
from edgectl.model.resource import RESOURCES
from edgectl.model.task import Tasks
from edgectl.units import parse_bytes, parse_cores, parse_rate
from tests.config.broken_files import INVENTORY

AMOUNTS = {"cpu": "1.36", "memory": "97.3Mi"}


def build_source(text: str) -> Source:
    return Source(file="t.yaml", text=text, lines=tuple(text.replace("\r\n", "\n").split("\n")))


def edit_text(text: str, entry: str = "t", amounts: dict[str, str] = AMOUNTS) -> str:
    after = edit_demand(build_source(text), entry, amounts)
    assert after is not None
    return after


HEAD = "version: 1\ntasks:\n"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("  t: {command: x, demand: {cpu: 35.2%, memory: 1Gi}}  # c", "  t: {command: x, demand: {cpu: 1.36, memory: 97.3Mi}}  # c"),
        ("  t: {command: x, demand: {cpu: 1}}", "  t: {command: x, demand: {cpu: 1.36, memory: 97.3Mi}}"),
        ("  t: {command: x, demand: {memory: 1, throughput: 2, }}", "  t: {command: x, demand: {memory: 97.3Mi, throughput: 2, cpu: 1.36, }}"),
        ("  t: {demand: {}, command: x}", "  t: {demand: {cpu: 1.36, memory: 97.3Mi}, command: x}"),
        ("  t: {command: x}", "  t: {command: x, demand: {cpu: 1.36, memory: 97.3Mi}}"),
        ("  t: {command: x, demand: {cpu: '1', memory: \"1Gi\"}}", "  t: {command: x, demand: {cpu: '1.36', memory: \"97.3Mi\"}}"),
        ("  t: {command: x, demand: {cpu: measured, memory: {until_measured: 1Gi}}}",
         "  t: {command: x, demand: {cpu: {until_measured: 1.36}, memory: {until_measured: 97.3Mi}}}"),
        ("  t: {command: x, demand: measured}",
         "  t: {command: x, demand: {cpu: {until_measured: 1.36}, memory: {until_measured: 97.3Mi}, throughput: measured}}"),
        ("  t:\n    command: x   # c\n    demand:   # d\n      # e\n      cpu: 1   # f\n\n      # g\n    # h\n  u: {command: x}",
         "  t:\n    command: x   # c\n    demand:   # d\n      # e\n      cpu: 1.36   # f\n      memory: 97.3Mi\n\n      # g\n    # h\n  u: {command: x}"),
        ("  t:\n    command: |\n      x\n    priority: 1  # c\n    env: {A: b}\n\n  u: {command: x}",
         "  t:\n    command: |\n      x\n    priority: 1  # c\n    env: {A: b}\n    demand: {cpu: 1.36, memory: 97.3Mi}\n\n  u: {command: x}"),
        ("  t:\n    demand:\n      throughput:\n        until_measured: 1  # c", None),
        ("  'é t': {command: 'é'}\r\n  t:\r\n    command: x  # é\r\n", "  'é t': {command: 'é'}\r\n  t:\r\n    command: x  # é\r\n    demand: {cpu: 1.36, memory: 97.3Mi}\r\n"),
    ],
)  # fmt: skip
def test_by_hand(before: str, after: str | None) -> None:
    expected = after or before + "\n      cpu: 1.36\n      memory: 97.3Mi"
    assert edit_text(HEAD + before) == HEAD + expected


@pytest.mark.parametrize(
    ("text", "line", "column", "message"),
    [
        (HEAD + "  t: {command: x, demand: &d {cpu: 1}}\n  u: {command: x, demand: *d}", 3, 27, "has an anchor or is an alias"),
        (HEAD + "  u: {command: x, demand: &d {cpu: 1}}\n  t: {command: x, demand: *d}", 4, 27, "has an anchor or is an alias"),
        (HEAD + "  t: &t {command: x}\n  u: *t", 3, 6, "has an anchor or is an alias"),
        ("version: 1\ntasks: &t\n  t: {command: x}", 2, 8, "has an anchor or is an alias"),
        (HEAD + "  t: {command: x, demand: {cpu: &c 1}}", 3, 33, "has an anchor or is an alias"),
        (HEAD + "  t:\n    command: |\n      x\n", 4, 5, "only by its indentation"),
        (HEAD + "  t: {command: x, demand: {  # c\n    }}", 3, 27, "empty except for comments"),
        (HEAD + "  t: {command: x, demand: {cpu: \"1\\\n    5\"}}", 3, 33, "spans several lines"),
    ],
)  # fmt: skip
def test_what_cannot_be_edited_safely_is_refused_with_its_place(
    text: str, line: int, column: int, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        edit_demand(build_source(text), "t", AMOUNTS)
    (problem,) = caught.value.problems
    assert (problem.line, problem.column) == (line, column)
    assert message in problem.message
    assert problem.hint == "edit it by hand: demand: {cpu: 1.36, memory: 97.3Mi}"


def test_another_file_has_the_entry() -> None:
    assert edit_demand(build_source(HEAD + "  u: {command: x}"), "t", AMOUNTS) is None
    assert edit_demand(build_source("version: 1"), "t", AMOUNTS) is None


# -- any file ----------------------------------------------------------------------------------------------------------------------------------

SAID = ("x", "'it''s'", '"a # b"', "run --é 1")
COMMENTS = st.sampled_from(["", "", "  #: why", "  #: é😀: {x}", "   "])
VALUES = {
    "cpu": st.sampled_from(["1", "35.2%", "'0.5'", "measured", "{until_measured: 2}", "500m"]),
    "memory": st.sampled_from(["1Gi", '"90Mi"', "2.5%", "measured", "{ until_measured: 1Mi }"]),
    "throughput": st.sampled_from(["0", "300kB/s", "measured"]),
}
PARSE = {"cpu": parse_cores, "memory": parse_bytes, "throughput": parse_rate}


@dataclass(frozen=True, slots=True)
class EditedFile:
    """A task file, the edited entry, and its new demand."""

    text: str
    entry: str
    amounts: dict[str, str]


@st.composite
def draw_flow(draw: st.DrawFn, entries: dict[str, str]) -> str:
    space = draw(st.sampled_from(["", " "]))
    comma = draw(st.sampled_from([", ", ",  ", ",\n        "]))
    return "{" + space + comma.join(f"{key}: {value}" for key, value in entries.items()) + space + "}"


@st.composite
def draw_demand(draw: st.DrawFn, *, block: bool) -> str | None:
    """Return the value of ``demand:``; None: the key is absent."""
    keys = draw(st.lists(st.sampled_from(sorted(VALUES)), unique=True))
    entries = {key: draw(VALUES[key]) for key in keys}
    kind = draw(st.integers(0, 3))
    if kind == 0:
        return draw(st.sampled_from([None, "measured", "{}"]))
    if kind == 1 or not block or not entries:
        return draw(draw_flow(entries))
    lines = [f"\n      {key}: {value}{draw(COMMENTS)}" for key, value in entries.items()]
    return draw(COMMENTS) + "".join(
        draw(st.sampled_from(["", "\n      #: above", "\n"])) + line for line in lines
    )


@st.composite
def draw_task(draw: st.DrawFn, name: str) -> str:
    block = draw(st.booleans())
    said = draw(
        st.sampled_from([*SAID, "|\n      x\n      y", ">-\n      x\n\n      y"] if block else list(SAID))
    )
    entries = {"command": said, "priority": draw(st.sampled_from(["1", "-2"])), "robot": "robot1"}
    demand = draw(draw_demand(block=block))
    if demand is not None:
        entries["demand"] = demand
    if draw(st.booleans()):
        entries["labels"] = "{a: b}" if not block or draw(st.booleans()) else "\n      a: b  #: l\n      c: d"
    order = draw(st.permutations(sorted(entries)))
    if not block:
        return f"  {name}: {draw(draw_flow({key: entries[key] for key in order}))}{draw(COMMENTS)}\n"
    lines = []
    for key in order:
        text = entries[key]
        lines += [draw(st.sampled_from(["", "", "\n", "    #: on its own\n"]))]
        lines += [
            f"    {key}:{'' if text.startswith((chr(10), '  #', '   ')) else ' '}{text}{draw(COMMENTS) if chr(10) not in text else ''}\n"
        ]
    return f"  {name}:{draw(COMMENTS)}\n" + "".join(lines)


@st.composite
def draw_file(draw: st.DrawFn) -> EditedFile:
    names = ["a", "b", "c"][: draw(st.integers(1, 3))]
    text = (
        "#: first\nversion: 1\ntasks:\n"
        + "".join(draw(draw_task(name)) for name in names)
        + draw(st.sampled_from(["", "#: last", "\n\n"]))
    )
    amounts = {
        key: value
        for key, value in (("cpu", "1.36"), ("memory", "97.3Mi"), ("throughput", "127kB/s"))
        if draw(st.booleans())
    }
    return EditedFile(
        text if draw(st.booleans()) else text.replace("\n", "\r\n"),
        draw(st.sampled_from(names)),
        amounts or {"cpu": "0"},
    )


def read_tasks(text: str) -> Tasks:
    with tempfile.TemporaryDirectory() as directory:
        (Path(directory) / "i.yaml").write_text(INVENTORY)
        (Path(directory) / "t.yaml").write_text(text, newline="")
        return load_inventory_and_tasks(Path(directory) / "i.yaml", Path(directory) / "t.yaml")[1]


def iterate_leaves(
    span: YamlSpan, text: str, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Return every value without nested values, as written; without the demands."""
    if "demand" in path:
        return
    for key, inner in span.entries.items():
        yield from iterate_leaves(inner, text, (*path, key))
    if not span.entries and not span.items:
        yield path, text[span.start : span.end].strip()


@settings(max_examples=150)
@given(draw_file())
def test_only_the_demand_changes(file: EditedFile) -> None:
    before = read_tasks(file.text)
    after = edit_text(file.text, file.entry, file.amounts)
    demand = before.tasks[file.entry].demand
    wanted = dict(demand)
    for resource in RESOURCES:
        if resource.demand_key in file.amounts:
            old, amount = demand[resource.name], file.amounts[resource.demand_key]
            wanted[resource.name] = Quantity(
                value=resource.unit.parse(amount), measured=old is not None and old.measured
            )
    task = replace(before.tasks[file.entry], demand=Demand(wanted))
    assert read_tasks(after).tasks == {**before.tasks, file.entry: task}
    assert re.findall(r"#:.*", after) == re.findall(r"#:.*", file.text)
    assert list(iterate_leaves(parse_spans(after), after)) == list(
        iterate_leaves(parse_spans(file.text), file.text)
    )
    assert edit_text(after, file.entry, file.amounts) == after
