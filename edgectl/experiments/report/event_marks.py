# SPDX-License-Identifier: Apache-2.0
"""Marks of events in figures: a dotted line where one begins, shade until it is undone, a sign by kind."""

from collections.abc import Iterable
from typing import Any

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from edgectl.experiments.model.experiment import Trial
from edgectl.experiments.model.mission_event import CHANGE_KEYS, EventRecord
from edgectl.experiments.report.figure_style import INK

CAPTION = " Dotted vertical lines are events of the mission, shaded until they are undone."
CAPTION_OF_MANY = " Short lines at the top of a panel are the events of all its trials."
_SIGNS = dict(zip(CHANGE_KEYS, ("s", "D", "X", "P", "o", "*", "h", "p"), strict=True))
_OTHER_SIGN = "d"
# Of the height of a panel.
_SHORT_FROM = 0.92
_LINE: dict[str, Any] = {"color": INK, "linestyle": (0, (1, 2)), "linewidth": 0.6, "zorder": 1.5}
_SHADE: dict[str, Any] = {"color": INK, "alpha": 0.07, "linewidth": 0.0, "zorder": 0.5}


def draw_event_marks(panel: Axes, records: Iterable[EventRecord], second: float) -> None:
    """Lines and shades of events that were brought about; ``second``: s per unit of the axis."""
    for record in records:
        panel.axvline(record.at / second, **_LINE)
        if record.until is not None:
            panel.axvspan(record.at / second, record.until / second, **_SHADE)


def draw_event_ticks(panel: Axes, records: Iterable[EventRecord], second: float) -> None:
    """Short lines at the top: those of many trials would cover the curves that they explain."""
    for record in records:
        panel.axvline(record.at / second, ymin=_SHORT_FROM, color=INK, linewidth=0.4)


def draw_event_signs(panel: Axes, records: Iterable[EventRecord], second: float) -> None:
    """The sign of the kind of each event, at the top of the panel."""
    for record in records:
        panel.plot(
            [record.at / second],
            [1.0],
            transform=panel.get_xaxis_transform(),
            clip_on=False,
            **_build_sign(record.kind),
        )


def list_event_kinds(trials: Iterable[Trial]) -> list[str]:
    """The kinds of events of all trials."""
    return list(dict.fromkeys(record.kind for trial in trials for record in trial.events))


def build_sign_legend(kinds: Iterable[str]) -> list[Line2D]:
    """An entry of a legend for each kind."""
    return [Line2D([], [], label=f"event: {kind}", **_build_sign(kind)) for kind in kinds]


def _build_sign(kind: str) -> dict[str, Any]:
    sign = _SIGNS.get(kind, _OTHER_SIGN)
    return {"linestyle": "none", "marker": sign, "markersize": 3.2, "color": INK, "markeredgewidth": 0.0}
