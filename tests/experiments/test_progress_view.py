# SPDX-License-Identifier: Apache-2.0
"""Progress messages of an experiment."""

from dataclasses import replace

import pytest

from edgectl.experiments.model.experiment import HandoffRecord, Trial, TrialProgress
from edgectl.experiments.views.progress import describe_trial_news, format_trial_state
from edgectl.model.cycle import Cycle
from edgectl.model.event import Event, EventKind

COURSE = TrialProgress(scheme="utility all", repetition=2, number=5, total=9, until=("merge", "tour"))
CYCLE = Cycle(number=3, at=0.0)
TRIAL = Trial(scheme="utility all", repetition=2, began_at=0.0, latency=62.25, finished=True)
HANDOFF = HandoffRecord(task="slam", source="edge1", target="edge2", at=3.0)


@pytest.mark.parametrize(
    ("course", "text"),
    [
        (COURSE, "trial 5 of 9: utility all, repetition 2"),
        (replace(COURSE, left=185.4), "trial 5 of 9: utility all, repetition 2 (about 3m05s left)"),
        (
            replace(COURSE, trial=TRIAL),
            "trial 5 of 9: utility all, repetition 2: finished in 1m02s, 0 handoffs",
        ),
        (
            replace(
                COURSE,
                trial=replace(
                    TRIAL, finished=False, latency=300.0, completed={"merge": 60.0}, handoffs=(HANDOFF,)
                ),
            ),
            "trial 5 of 9: utility all, repetition 2: not finished, tour did not complete (counts as 5m00s); 1 handoff",
        ),
        (replace(COURSE, cycle=CYCLE), ""),
    ],
)
def test_a_trial_has_a_line_at_its_beginning_and_one_at_its_end(course: TrialProgress, text: str) -> None:
    assert describe_trial_news(None, course) == text


def test_trouble_has_a_line_when_it_begins_and_what_goes_well_has_none() -> None:
    events = (
        Event(at=0.0, kind=EventKind.TASK_READY, task="slam"),
        Event(at=0.0, kind=EventKind.TASK_FAILED, task="slam", host="edge1"),
    )
    cycle = replace(CYCLE, events=events, warnings=("the disk is full",), error="x\x1b[31m")
    told = describe_trial_news(None, replace(COURSE, cycle=cycle))
    assert told.startswith(
        "utility all, repetition 2: task-failed slam on edge1; utility all, repetition 2: warning: the disk is full; "
    )
    assert "\x1b" not in told
    assert describe_trial_news(cycle, replace(COURSE, cycle=replace(cycle, events=()))) == ""


def test_the_live_line_says_how_far_it_is() -> None:
    course = replace(COURSE, cycle=CYCLE, completed=("merge",), elapsed=65.2, left=600.0)
    assert format_trial_state(course) == "utility all 2: 1/2 completed, 1m05s, about 10m00s left"
