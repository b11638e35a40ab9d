"""Recovery after an event: the time until what it disturbed is as good as before (ADR 133). Pure."""

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

# Between the moments at which something changes, means are looked at so often.
_STEP_S = 0.5


Points = Sequence[tuple[float, float | None]]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecoveryRule:
    """``window`` of the means before and after, and ``steady``: for how long it has to stay good, both in s.

    ``within``: how much worse than before still counts as good, as a share. ``higher``: more is better, and
    time without running counts as 0; otherwise less is better, and such time does not count.
    """

    window: float = 10.0
    steady: float = 10.0
    within: float = 0.1
    higher: bool = True


class Course:
    """How well a wanted task does over time, from its first point to ``end``.

    ``points``: (s, value), ascending; a value holds until the next point, None: the task does not run.
    """

    def __init__(self, points: Points, end: float) -> None:
        self.times = [at for at, _ in points]
        self.values = [value for _, value in points]
        self.end = end
        lengths = [max(0.0, until - since) for since, until in pairwise([*self.times, end])]
        pairs = list(zip(lengths, self.values, strict=True))
        self._areas = [0.0, *accumulate(length * (value or 0.0) for length, value in pairs)]
        self._running = [0.0, *accumulate(length * (value is not None) for length, value in pairs)]

    def is_wanted(self, at: float) -> bool:
        """Whether the task is wanted at ``at``."""
        return bool(self.times) and self.times[0] <= at < self.end

    def get_value(self, at: float) -> float | None:
        """The value at ``at``; None where the task does not run."""
        index = bisect_right(self.times, at) - 1
        return self.values[index] if index >= 0 and at < self.end else None

    def ran_before(self, at: float) -> bool:
        """Whether it ran just before ``at``: what changes at that very moment comes after."""
        index = bisect_left(self.times, at) - 1
        return index >= 0 and at < self.end and self.values[index] is not None

    def compute_mean(self, since: float, until: float, rule: RecoveryRule) -> float:
        """The mean over the part of a time in which the task is wanted."""
        since, until = max(since, self.times[0]), min(until, self.end)
        (area, running), (later_area, later_running) = self._integrate(since), self._integrate(until)
        seconds = until - since if rule.higher else later_running - running
        return (later_area - area) / seconds if seconds > 0 else self.get_value(since) or 0.0

    def _integrate(self, until: float) -> tuple[float, float]:
        """The integral of the value, and the time of running, up to a moment."""
        index = bisect_right(self.times, until) - 1
        value, seconds = self.values[index], until - self.times[index]
        return self._areas[index] + seconds * (value or 0.0), self._running[index] + seconds * (
            value is not None
        )


def compute_recoveries(
    courses: Mapping[str, Course],
    events: Sequence[tuple[float, Collection[str]]],
    end: float,
    rule: RecoveryRule,
) -> list[float | None]:
    """Recovery of each event in s; None: not recovered before a later event, or before the mission's ``end``.

    ``events``: when they began, and the tasks that entered with them. Events that begin within ``steady`` s
    of each other disturb together.
    """
    begins = sorted(at for at, _ in events)
    found = []
    for at, entering in events:
        until = next((begin for begin in begins if begin > at + rule.steady), end)
        found.append(_compute_recovery(courses, at, entering, until, rule))
    return found


def _compute_recovery(
    courses: Mapping[str, Course], at: float, entering: Collection[str], until: float, rule: RecoveryRule
) -> float | None:
    """S from ``at`` to the first moment from which all is good for ``steady`` s, or up to ``until``."""
    before = {
        name: course.compute_mean(at - rule.window, at, rule)
        for name, course in courses.items()
        if course.ran_before(at)
    }
    if any(name not in courses for name in entering):
        return None
    wanted = {name: courses[name] for name in {*before, *entering}}
    entered = max((courses[name].times[0] for name in entering), default=at)
    recovered, good_until = None, until
    for moment in reversed(_list_moments(wanted.values(), at, until)):
        if moment < entered or not _is_good(wanted, before, moment, until, rule):
            good_until = moment
        elif good_until >= min(moment + rule.steady, until):
            recovered = moment
    return None if recovered is None else recovered - at


def _list_moments(courses: Iterable[Course], at: float, until: float) -> list[float]:
    """The moments to look at: every so often, and whenever something changes."""
    moments = {at + number * _STEP_S for number in range(max(1, int((until - at) / _STEP_S)))}
    moments |= {time for course in courses for time in (*course.times, course.end) if at <= time < until}
    return sorted(moments)


def _is_good(
    wanted: Mapping[str, Course], before: Mapping[str, float], at: float, until: float, rule: RecoveryRule
) -> bool:
    """Whether all tasks run that are still wanted, and will do as well as before."""
    current = {name: course for name, course in wanted.items() if course.is_wanted(at)}
    if any(course.get_value(at) is None for course in current.values()):
        return False
    known = [name for name in current if name in before]
    then = sum(before[name] for name in known)
    end = min(at + rule.window, until)
    now = sum(current[name].compute_mean(at, end, rule) for name in known)
    return now >= (1.0 - rule.within) * then if rule.higher else now <= (1.0 + rule.within) * then
