# SPDX-License-Identifier: Apache-2.0
"""Figures and page of a report: complete, readable, self-contained and reproducible."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from itertools import combinations
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import pytest

from edgectl.experiments.model.experiment import ExperimentRun, HostCapacity, LoadSample, MetricReading, Trial
from edgectl.experiments.model.mission_event import CHANGE_KEYS, EventRecord
from edgectl.experiments.model.schemes import Scheme
from edgectl.experiments.report.trial_selection import (
    get_median_trial,
    list_missing_trials,
    list_tried_schemes,
)
from edgectl.model.inventory import Role
from edgectl.model.policy import Policy
from tests.experiments.sample_runs import SCHEMES, a_run

# Each worker of the suite reads every test file; matplotlib, which these modules import, takes it a second.
if TYPE_CHECKING:
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    from edgectl.experiments.report.figure_style import ReportFigure

VOID = {"meta", "wbr"}
MANY = tuple(
    Scheme(name=f"utility weights of the task files margin {number / 20:g}", policy=Policy())
    for number in range(12)
)


class Outline(HTMLParser):
    """Fails where an element is not closed, closed twice or crossed; keeps ids, what is referred to, and the words."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.references: list[str] = []
        self.elements: set[str] = set()
        self.words = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.add(tag)
        found = dict(attrs)
        self.ids += [found["id"] or ""] if "id" in found else []
        self.references += [
            value or "" for name, value in attrs if name in ("href", "src", "xlink:href", "srcset", "action")
        ]
        self.references += re.findall(r"url\(([^)]*)\)", " ".join(value or "" for _, value in attrs))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"{tag} at {self.getpos()}"

    def handle_data(self, data: str) -> None:
        self.words += data if self.open[-1:] != ["style"] else ""


def draw(run: ExperimentRun) -> "list[ReportFigure]":
    from edgectl.experiments.report.report import draw_figures

    return draw_figures(run)


def a_page(run: ExperimentRun, *, drawn: bool = True, recovery: Sequence[Sequence[str]] = ()) -> str:
    from edgectl.experiments.report.figure_style import inline_svg_from_document, render_svg
    from edgectl.experiments.report.page import EmbeddedFigure, ReportTable, render_report_page

    table = ReportTable(
        rows=[["SCHEME", "LATENCY s"], *([variant.name, "1±2/3±4"] for variant in run.experiment.schemes)],
        notes=["A note."],
        answer="utility <all> finished sooner.",
        compared=[["SCHEME", "AGAINST", "RATIO"], ["utility all", "static", "0.84 [0.73, 0.96]"]],
        recovery=recovery,
    )
    return render_report_page(
        run,
        table,
        [
            EmbeddedFigure(
                name=d.name,
                title=d.title,
                caption=d.caption,
                svg=inline_svg_from_document(render_svg(d), d.title),
            )
            for d in (draw(run) if drawn else [])
        ],
    )


def bare(run: ExperimentRun, *trials: Trial) -> ExperimentRun:
    return replace(run, trials=trials)


def keep_loads(run: ExperimentRun, *hosts: str) -> ExperimentRun:
    """The loads of these hosts alone: a panel of a figure takes 30 ms, and each host has one for each scheme."""
    return bare(
        run, *(replace(trial, loads={host: trial.loads[host] for host in hosts}) for trial in run.trials)
    )


def keep_readings(run: ExperimentRun, *names: str) -> ExperimentRun:
    return bare(
        run,
        *(replace(trial, readings={name: trial.readings[name] for name in names}) for trial in run.trials),
    )


def nothing(run: ExperimentRun) -> ExperimentRun:
    """Trials of which only the latency is known."""
    return bare(
        run,
        *(
            Trial(scheme=t.scheme, repetition=t.repetition, began_at=t.began_at, latency=9.0, finished=True)
            for t in run.trials
        ),
    )


def degenerate() -> Iterator[tuple[str, ExperimentRun]]:
    run = keep_loads(a_run(SCHEMES[2:3], 2), "edge1", "robot1")
    loads, readings = keep_readings(run), keep_loads(run)
    yield "one trial", keep_loads(a_run(trials=1), "edge1")
    yield "one scheme, one trial", a_run(SCHEMES[2:3], 1)
    yield (
        "none finished",
        bare(run, *(replace(trial, finished=False, latency=300.0, completed={}) for trial in run.trials)),
    )
    yield "nothing but latencies", nothing(run)
    yield "no latency at all", bare(run, *(replace(trial, latency=0.0) for trial in nothing(run).trials))
    yield (
        "one sample",
        bare(
            run,
            *(
                replace(trial, loads={name: rows[:1] for name, rows in trial.loads.items()})
                for trial in loads.trials
            ),
        ),
    )
    yield "idle", bare(loads, *(replace(trial, loads={"edge1": _still()}) for trial in loads.trials))
    yield (
        "unmeasured downtime",
        bare(
            loads,
            *(
                replace(t, handoffs=tuple(replace(h, downtime=None) for h in t.handoffs))
                for t in loads.trials
            ),
        ),
    )
    yield (
        "negative metric",
        bare(readings, *(replace(trial, readings=_negative(trial)) for trial in readings.trials)),
    )
    yield (
        "absurd metric",
        bare(readings, *(replace(trial, readings=_absurd(trial)) for trial in readings.trials)),
    )
    yield (
        "hosts that nobody knows",
        replace(loads, machines={"edge9": HostCapacity(role=Role.EDGE, cores=2.0, memory=2.0**31)}),
    )
    yield "hours", bare(run, *(_slower(trial, 120.0) for trial in run.trials))
    many = a_run(MANY, 2)
    yield (
        "many",
        bare(
            many,
            *(replace(trial, loads={"edge1": trial.loads["edge1"]}, readings={}) for trial in many.trials),
        ),
    )
    yield "events", disturb(run)
    yield "large fleet", _larger(keep_readings(a_run(SCHEMES[2:3], 1)))


def disturb(run: ExperimentRun) -> ExperimentRun:
    """With an event of each kind in each trial; two at once, one that failed, and one with a name like markup."""
    records = (
        EventRecord(event="in", kind="join", subject="robot2", at=4.0),
        *(
            EventRecord(event=kind, kind=kind, subject="edge1", at=10.0 * number, until=10.0 * number + 5.0)
            for number, kind in enumerate((*CHANGE_KEYS, "event"))
        ),
        EventRecord(event="far", kind="link", subject="<b>edge1</b>", at=10.0, error="tc exited with <1>"),
    )
    return bare(run, *(replace(trial, events=records) for trial in run.trials))


def test_events_are_listed_and_marked() -> None:
    run = disturb(keep_readings(keep_loads(a_run(SCHEMES[1:3], 1), "edge1"), "fps"))
    page = a_page(run, recovery=[["RECOVERY s", "LINK"], ["static", "12.5±2.0 (1 of 4 not)"]])
    words = Outline(page).words
    assert "12.5±2.0 (1 of 4 not)" in words
    assert "<b>edge1</b>" in words
    assert "tc exited with <1>" in words
    assert words.count("not recovered") == 0
    plain = Outline(a_page(bare(run, *(replace(trial, events=()) for trial in run.trials)))).words
    assert "Every event" in words
    assert "Every event" not in plain
    figures = {drawing.name: drawing for drawing in draw(run)}
    for name in ("gantt", "cpu", "metric-1"):
        assert "Dotted vertical lines are events" in figures[name].caption
        for panel in figures[name].figure.axes:
            dotted = [line for line in panel.lines if line.get_linestyle() == ":" or _is_dotted(line)]
            assert len(dotted) == len(run.trials[0].events), name
    legend = [text.get_text() for text in figures["gantt"].figure.legends[0].get_texts()]
    assert [text for text in legend if text.startswith("event: ")] == [
        f"event: {kind}" for kind in dict.fromkeys(record.kind for record in run.trials[0].events)
    ]
    assert all("Dotted" not in drawing.caption for drawing in draw(a_run(SCHEMES[1:2], 1, trials=1)))


def test_events_of_many_trials_do_not_cover_their_lines() -> None:
    run = disturb(keep_loads(a_run(SCHEMES[1:3], 3), "edge1"))
    (cpu,) = (drawing for drawing in draw(run) if drawing.name == "cpu")
    assert "Short lines at the top" in cpu.caption
    for panel in cpu.figure.axes:
        marks = [line for line in panel.lines if _is_upright(line)]
        assert len(marks) == 3 * len(run.trials[0].events)
        assert all(_find_lowest(line) > 0.9 for line in marks)


def _is_dotted(line: Any) -> bool:
    return line.get_linestyle() == "--" and _is_upright(line)


def _is_upright(line: Any) -> bool:
    return list(line.get_xdata()) == [line.get_xdata()[0]] * 2


def _find_lowest(line: Any) -> float:
    return float(min(line.get_ydata()))


def _larger(run: ExperimentRun) -> ExperimentRun:
    more = [f"edge{number}" for number in range(4, 15)]
    trials = (
        replace(trial, loads={**trial.loads, **dict.fromkeys(more, trial.loads["edge1"])})
        for trial in run.trials
    )
    return bare(
        replace(run, machines={**run.machines, **dict.fromkeys(more, run.machines["edge1"])}), *trials
    )


def _still() -> tuple[LoadSample, ...]:
    return tuple(LoadSample(at=at, cores=0.0, memory=0.0, bytes_per_s=0.0) for at in (0.0, 0.0, 5.0))


def _negative(trial: Trial) -> dict[str, dict[str, tuple[MetricReading, ...]]]:
    return {
        "loss": {
            task: tuple(replace(each, value=-each.value) for each in rows)
            for task, rows in trial.readings["loss"].items()
        }
    }


def _absurd(trial: Trial) -> dict[str, dict[str, tuple[MetricReading, ...]]]:
    rows = trial.readings["loss"]["map-merge"]
    return {
        name: {"map-merge": tuple(replace(each, value=value) for each in rows)}
        for name, value in (("loss", 1e308), ("fps", 5e-324))
    }


def _slower(trial: Trial, times: float) -> Trial:
    spans = tuple(replace(span, start=span.start * times, end=span.end * times) for span in trial.spans)
    loads = {
        host: tuple(replace(load, at=load.at * times) for load in rows) for host, rows in trial.loads.items()
    }
    return replace(trial, latency=trial.latency * times, spans=spans, loads=loads)


DEGENERATE = list(degenerate())


@pytest.mark.parametrize("run", [run for _, run in DEGENERATE], ids=[name for name, _ in DEGENERATE])
def test_whatever_a_run_has_gives_a_whole_page(run: ExperimentRun) -> None:
    """Warnings are errors, so nothing is drawn that matplotlib has doubts about."""
    found = Outline(a_page(run))
    assert len(found.ids) == len(set(found.ids)), "figures share ids"
    for variant in run.experiment.schemes:
        assert variant.name in found.words


@cache
def page_of_two_schemes() -> str:
    return a_page(keep_readings(a_run(SCHEMES[1:3], 1), "fps"))


def test_the_page_needs_nothing_but_itself() -> None:
    text = page_of_two_schemes()
    found = Outline(text)
    assert "script" not in found.elements
    assert not found.elements & {"link", "img", "iframe", "object", "embed", "image", "base", "form"}
    places = [reference.strip("'\"") for reference in found.references]
    assert places
    assert {place[1:] for place in places} <= set(found.ids)
    assert all(place.startswith("#") for place in places), "something is fetched"
    assert set(re.findall(r"\w+://[^\s\"<]*", text)) == {
        "http://www.w3.org/1999/xlink",
        "http://www.w3.org/2000/svg",
    }
    assert "@import" not in text


def test_every_name_stands_in_the_page() -> None:
    run = a_run(SCHEMES[1:3], 1)
    words = Outline(page_of_two_schemes()).words
    names = (
        {trial.scheme for trial in run.trials}
        | set(run.machines)
        | {span.task for trial in run.trials for span in trial.spans}
    )
    assert [name for name in names if name not in words] == []
    assert run.digest in words
    assert "2026-11-21T11:00:00Z" in words
    assert "A note." in words


def test_the_page_opens_with_the_answer() -> None:
    text = a_page(a_run(SCHEMES[1:3], 1), drawn=False)
    assert '</h1>\n<p class="answer">utility &lt;all&gt; finished sooner.</p>\n' in text
    words = Outline(text).words
    assert words.index("sooner.") < words.index("Table")
    assert words.index("AGAINST") < words.index("0.84 [0.73, 0.96]") < words.index("Figures")


def test_drawings_are_whole_and_never_vary() -> None:
    from edgectl.experiments.report.figure_style import render_pdf, render_svg

    run = keep_loads(a_run(SCHEMES[2:3], 2), "edge1", "robot1")
    first, second = draw(run), draw(run)
    assert a_page(run, drawn=False) == a_page(run, drawn=False)
    assert [drawing.name for drawing in first] == [
        "latency",
        "tasks",
        "cpu",
        "memory",
        "throughput",
        "gantt",
        "handoffs",
        "metric-1",
        "metric-2",
    ]
    for one, other in zip(first, second, strict=True):
        text = render_svg(one)
        assert ET.fromstring(text).tag == "{http://www.w3.org/2000/svg}svg"
        assert b"<text" in text, "words that can be found"
        assert text == render_svg(other)
        assert one.caption.endswith(".")
        assert len(one.caption) > 40
    document = render_pdf(
        first[5]
    )  # the fonts of a PDF take a second; what is drawn in it is that of the SVG
    assert document.startswith(b"%PDF-")
    assert document == render_pdf(second[5])
    assert b"CreationDate" not in document


def test_what_a_file_says_is_words_and_never_markup() -> None:
    from edgectl.experiments.report.figure_style import render_svg

    bad = "<script>alert(1)</script>&\"'$x^2$\x01"
    run = keep_loads(a_run(SCHEMES[:1], 1, name=bad))
    trial = replace(run.trials[0], readings={bad: run.trials[0].readings["fps"]})
    text = a_page(replace(run, digest=bad, trials=(trial,)))
    found = Outline(text)
    assert "script" not in found.elements
    assert bad in found.words
    for drawing in draw(replace(run, trials=(trial,))):
        ET.fromstring(render_svg(drawing))


def test_a_name_in_a_script_that_the_font_lacks_is_drawn_all_the_same() -> None:
    from edgectl.experiments.report.figure_style import render_pdf, render_svg

    run = a_run(SCHEMES[:1], 1)
    trial = replace(run.trials[0], loads={}, readings={"速度": run.trials[0].readings["fps"]})
    found = draw(replace(run, trials=(trial,)))
    assert "速度" in render_svg(found[-1]).decode()
    assert render_pdf(found[-1]).startswith(b"%PDF-")


@pytest.mark.parametrize(
    "run",
    [
        keep_readings(a_run(SCHEMES[:3], 1), "loss"),
        disturb(keep_readings(keep_loads(a_run(SCHEMES[2:3], 1), "edge1", "edge2"), "fps")),
        keep_loads(keep_readings(a_run(MANY[:7], 1), "fps"), "edge1", "edge2"),
    ],
    ids=["every host", "events", "many schemes with long names"],
)
def test_words_neither_overlap_nor_leave_the_figure(run: ExperimentRun) -> None:
    for drawing in draw(run):
        if drawing.name in ("memory", "throughput"):
            continue  # as cpu
        boxes = extents(drawing)
        assert len(boxes) > 5
        inside = drawing.figure.bbox.padded(1.0)
        assert [
            words
            for words, box in boxes
            if not (inside.contains(box.x0, box.y0) and inside.contains(box.x1, box.y1))
        ] == [], drawing.name
        smaller = [(words, box.padded(-1.0)) for words, box in boxes]
        assert [
            (one, other) for (one, here), (other, there) in combinations(smaller, 2) if here.overlaps(there)
        ] == [], drawing.name


def extents(drawing: "ReportFigure") -> "list[tuple[str, Bbox]]":
    """Where each word of a figure stands, in pixels."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    canvas: Any = FigureCanvasAgg(drawing.figure)
    drawing.figure.set_dpi(150)
    drawing.figure.draw_without_rendering()
    beyond = set(_beyond(drawing))
    texts = [
        text
        for text in drawing.figure.findobj(Text)
        if text.get_visible() and text.get_text().strip() and text not in beyond
    ]
    return [(text.get_text(), text.get_window_extent(canvas.get_renderer())) for text in texts]


def _beyond(drawing: "ReportFigure") -> "Iterator[Text]":
    """Labels of ticks that are not drawn, because they lie outside of the axis."""
    for axis in (axis for axes in drawing.figure.axes for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        yield from (
            tick.label1 for tick in axis.get_major_ticks() if not low - 1e-9 <= tick.get_loc() <= high + 1e-9
        )


def test_what_is_missing_or_unfinished_is_said() -> None:
    run = a_run(SCHEMES[:3], 3, trials=7)
    run = replace(run, trials=(replace(run.trials[0], finished=False), *run.trials[1:]))
    assert list_missing_trials(run) == [("utility cpu", 2), ("utility cpu", 3)]
    words = Outline(a_page(run, drawn=False)).words
    assert "Not run yet: 2 of 9 trials. utility cpu: 2, 3." in words
    assert "Ended by the time limit of 5m00s: 1 of 7 trials. local: 1." in words
    assert "Not run yet" not in Outline(a_page(a_run(SCHEMES[:1], 1), drawn=False)).words


def test_the_typical_trial_is_a_finished_one_of_median_latency() -> None:
    run = a_run(SCHEMES[:1], 4)
    found = [
        replace(trial, latency=latency)
        for trial, latency in zip(run.trials, (40.0, 10.0, 30.0, 5.0), strict=True)
    ]
    found[3] = replace(found[3], finished=False)
    assert get_median_trial(bare(run, *found), "local").latency == 30.0
    assert get_median_trial(bare(run, found[3]), "local").latency == 5.0
    assert list_tried_schemes(bare(run, *found)) == ["local"]
    assert get_median_trial(bare(run, *found[:2]), "local").latency == 10.0


def test_the_mean_goes_on_while_half_of_the_trials_do() -> None:
    from edgectl.experiments.report.time_series_plots import _compute_mean_series

    assert _compute_mean_series([[(0.0, 0.0), (10.0, 10.0)], [(0.0, 2.0), (4.0, 2.0)]], 5.0) == [
        (0.0, 1.0),
        (5.0, 3.5),
        (10.0, 10.0),
    ]
    assert _compute_mean_series(
        [[(0.0, 0.0), (10.0, 10.0)], [(1.0, 2.0), (5.0, 4.0)], [(0.0, 4.0), (5.0, 6.0)]], 5.0
    ) == [(0.0, 2.0), (5.0, 5.0)]
    assert _compute_mean_series([[(5.1, 3.0), (9.9, 4.0)], [(5.2, 5.0), (9.0, 6.0)]], 5.0) == [
        (5.0, 4.0),
        (10.0, 5.0),
    ], "samples are never on the dot"
    assert _compute_mean_series([[(5.1, 3.0), (9.9, 4.0)]], 5.0) == [(5.1, 3.0), (9.9, 4.0)]
    assert _compute_mean_series([], 5.0) == []


def test_each_scheme_keeps_its_colour() -> None:
    from edgectl.experiments.report.figure_style import SCHEME_COLOURS, get_scheme_colour

    run = a_run(SCHEMES, 1, trials=4)
    assert [get_scheme_colour(run, variant.name) for variant in SCHEMES] == list(
        SCHEME_COLOURS[: len(SCHEMES)]
    )


def test_a_colour_means_one_thing() -> None:
    """Full colours are schemes, light ones hosts; a dozen schemes have a colour each."""
    from edgectl.experiments.report.figure_style import FAINT, GRID, INK, SCHEME_COLOURS
    from edgectl.experiments.report.gantt_chart import _HOST_COLOURS

    used = [*SCHEME_COLOURS, *_HOST_COLOURS, INK, FAINT, GRID]
    assert len(SCHEME_COLOURS) == 12
    assert len(set(used)) == len(used)
    assert max(map(luminance, SCHEME_COLOURS)) < min(map(luminance, _HOST_COLOURS))


@pytest.mark.parametrize("latency", [60.0, 180.0])
def test_times_of_missions_have_one_unit(latency: float) -> None:
    run = a_run(SCHEMES[1:3], 2)
    run = replace(run, trials=tuple(replace(each, latency=latency) for each in run.trials))
    words = Outline(a_page(run)).words
    units = {
        unit
        for unit in ("s", "min")
        if f"({unit})" in re.sub(r"[Dd]owntime[^(]*\(s\)|greatest \(s\)", "", words)
    }
    assert units == ({"s"} if latency < 120 else {"min"})


@pytest.mark.parametrize("ground", [1.0, 0.0], ids=["white", "black"])
def test_colours_stand_out_on_paper_and_on_a_dark_screen(ground: float) -> None:
    """WCAG's contrast for graphics is 3:1."""
    from edgectl.experiments.report.figure_style import SCHEME_COLOURS

    for colour in SCHEME_COLOURS:
        light = luminance(colour)
        assert (max(light, ground) + 0.05) / (min(light, ground) + 0.05) >= 3.0, colour


def luminance(colour: str) -> float:
    channels = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
