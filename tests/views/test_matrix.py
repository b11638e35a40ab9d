# SPDX-License-Identifier: Apache-2.0
"""Every read command's view x form x width x colour: what holds of all tables that people read.

The same snapshots as tests/views/test_forms.py and its neighbours; no host is asked. At 60 and 80 columns a line may be
longer only where a name, an address or a digest alone is: such words stay whole.
"""

import re
from collections.abc import Iterator

import pytest

from edgectl.model.plan import Plan
from edgectl.views.output import View, render_view
from edgectl.views.output_format import OutputFormat, is_supported
from edgectl.views.plan import PlanView
from edgectl.views.profile import ProfileView
from edgectl.views.text import RenderOptions
from tests.views import test_forms, test_glossary
from tests.views.fixtures import plan as fixture_plan

WIDTHS = (60, 80, None)
NAMES = re.compile(r"\b(?:detection|slam|navigation)-robot\d\b|\bmap-merge\b|\bedge\d\b|\brobot\d\b")
ESCAPE = re.compile(r"\x1b\[\d+m")
# A table begins with headings: at least two words in capitals, each the only one of its column.
HEADING = re.compile(r"[A-Z][A-Z0-9%]*(?: [A-Z0-9%]+)*")


def list_matrix() -> Iterator[tuple[str, View, OutputFormat]]:
    seen: dict[str, int] = {}
    named = [*test_forms.views().items(), *((type(view).__name__, view) for view in test_glossary.VIEWS)]
    for name, view in named:
        if name == "CycleView":  # lines of a journal; its table is the screen of tests/views/test_live.py
            continue
        seen[name] = seen.get(name, 0) + 1
        for form in (OutputFormat.TABLE, OutputFormat.WIDE):
            if is_supported(form, view.formats):
                yield f"{name}{seen[name]}-{form}", view, form


MATRIX = list(list_matrix())


def render(view: View, form: OutputFormat, width: int | None, *, colour: bool = False) -> str:
    return render_view(view, form, RenderOptions(width=width, colour=colour))


def list_columns(line: str) -> list[tuple[int, int]] | None:
    """Begin and end of each column, if the line consists of headings."""
    words = re.split(r" {2,}", line.strip())
    if len(words) < 2 or not all(HEADING.fullmatch(word) for word in words):
        return None
    return [found.span() for found in re.finditer(r"\S+(?: \S+)*", line)]


def find_numbers_without_heading(text: str) -> list[str]:
    """Numbers in tables that stand under no heading."""
    columns, lost = None, []
    for line in text.splitlines():
        columns = list_columns(line) or (columns if line.strip() else None)
        if columns is None or list_columns(line):
            continue
        for found in re.finditer(r"\S+(?: \S+)*", line):
            begin, end = found.span()
            under = any(begin < right and left < end for left, right in columns)
            if re.match(r"[-+]?\d", found[0]) and not under:
                lost.append(line)
    return lost


@pytest.mark.parametrize(("view", "form"), [row[1:] for row in MATRIX], ids=[row[0] for row in MATRIX])
def test_a_table_reads_well_at_every_width(view: View, form: OutputFormat) -> None:
    whole = render(view, form, None)
    assert "\x1b" not in whole
    assert all(char.isascii() or char == "±" for char in whole)
    assert find_numbers_without_heading(whole) == []
    for width in WIDTHS:
        plain = render(view, form, width)
        assert ESCAPE.sub("", render(view, form, width, colour=True)) == plain, (
            "colour carries no meaning alone"
        )
        if not isinstance(view, ProfileView):  # it leaves out hosts where there is no room
            assert set(NAMES.findall(whole)) <= set(NAMES.findall(plain)), f"a name is split at {width}"
        assert all(line == line.rstrip() for line in plain.splitlines())


@pytest.mark.parametrize("width", [60, 80])
@pytest.mark.parametrize("name", ["plan", "status", "probe"])
def test_what_people_read_daily_fits(name: str, width: int) -> None:
    text = render(dict(_list_daily())[name], OutputFormat.TABLE, width)
    assert [line for line in text.splitlines() if len(line) > width] == []


def _list_daily() -> Iterator[tuple[str, View]]:
    shown = test_forms.views()
    yield from ((name, shown[name]) for name in ("plan", "status"))
    yield "probe", shown["snapshot"]


def test_cores_below_a_tenth_are_thousandths() -> None:
    text = render(dict(_list_daily())["status"], OutputFormat.TABLE, None)
    assert re.search(r"\b\d{1,2}m\b", text)
    assert not re.search(r"\b0\.0\d\b(?!\d)", text)


def test_a_plan_of_two_hundred_tasks_shows_the_change_and_folds_the_rest() -> None:
    plan = fixture_plan()
    kept = [step for step in plan.steps if not step.changes]
    many = Plan(
        **{key: getattr(plan, key) for key in plan.__dataclass_fields__}
        | {"steps": (*kept * 22, *plan.steps), "fleet": "lab"}
    )
    lines = PlanView(many).table(RenderOptions(width=80)).splitlines()
    assert lines[0] == "Fleet lab, weights all, snapshot of 2026-11-21T03:02:39Z"
    assert lines[3].startswith("~  detection-robot1")
    assert "=  207 kept (-o wide shows all)" in lines
    assert len(lines) < 25
    wide = PlanView(many).wide()
    assert wide.count("\n=  ") == 207
    assert wide.index("\n~  ") < wide.index("\n=  ")
    assert "Legend:\n  Symbols: ~ move, = keep." in wide


def test_pins_and_ties_stand_in_words() -> None:
    wide = render(test_forms.views()["plan"], OutputFormat.WIDE, None)
    assert re.search(r"=  slam-robot1 +edge1 .* keep: pinned to edge1\n", wide)
