# SPDX-License-Identifier: Apache-2.0
"""Order of placement: predecessors first, then by key, independent of the order in the file."""

import pytest

from edgectl.model.policy import SequenceRule
from edgectl.model.task import Task
from edgectl.scheduler.sequence import order_tasks
from tests.builders import a_task

CONNECTIVITY, SENSITIVITY = SequenceRule.CONNECTIVITY, SequenceRule.SENSITIVITY


@pytest.mark.parametrize(
    ("rule", "tasks", "expected"),
    [
        # no criterion but names, in natural order
        (CONNECTIVITY, [a_task("t10"), a_task("t2"), a_task("t1")], "t1 t2 t10"),
        # priority first: high before low, then name
        (CONNECTIVITY, [a_task("a"), a_task("b", priority=5.0), a_task("c", priority=-1.0)], "b a c"),
        # a need beats a priority: b waits for a, and then goes before c
        (CONNECTIVITY, [a_task("a"), a_task("b", priority=5.0, needs=["a"]), a_task("c", priority=1.0)], "c a b"),
        # repeatedly: after slam-1 its successor nav-1 is eligible, and is the first by name
        (CONNECTIVITY, [a_task("slam-2"), a_task("slam-1"), a_task("nav-1", needs=["slam-1"]), a_task("merge", needs=["slam-1", "slam-2"])],
         "slam-1 nav-1 slam-2 merge"),
        # deadline: short first, none last; then priority; then name
        (SENSITIVITY, [a_task("a"), a_task("b", deadline=9.0), a_task("c", deadline=3.0), a_task("d", priority=2.0)], "c b d a"),
        (SENSITIVITY, [a_task("a", deadline=1.0, needs=["z"]), a_task("z")], "z a"),
        # a deadline is ignored if connectivity is asked for
        (CONNECTIVITY, [a_task("b", deadline=1.0), a_task("a")], "a b"),
        # a need outside the file does not block the sequence
        (CONNECTIVITY, [a_task("a", needs=["elsewhere"])], "a"),
    ],
)  # fmt: skip
def test_order(rule: SequenceRule, tasks: list[Task], expected: str) -> None:
    assert [task.name for task in order_tasks(tasks, rule)] == expected.split()
    assert [task.name for task in order_tasks(tasks[::-1], rule)] == expected.split()


def test_a_cycle_is_refused_by_name() -> None:
    tasks = [a_task("a", needs=["c"]), a_task("b", needs=["a"]), a_task("c", needs=["b"]), a_task("free")]
    with pytest.raises(ValueError, match="cycle among a, b, c"):
        order_tasks(tasks, CONNECTIVITY)
