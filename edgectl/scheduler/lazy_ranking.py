# SPDX-License-Identifier: Apache-2.0
"""Rankings and demands that are made when they are first read: most are never looked at (ADR 0075)."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from typing import NamedTuple, TypeVar, overload

from edgectl.dataclass import dataclass
from edgectl.model.assignment import RankedHost, Rejection, ResourceDemand
from edgectl.model.task import Task
from edgectl.scheduler.candidates import AssignmentContext, gather_candidates, weigh_candidates
from edgectl.scheduler.demand import list_resource_demands
from edgectl.scheduler.ledger import Ledger
from edgectl.scheduler.ranking import rank_hosts
from edgectl.scheduler.task_usage import TaskUsage

Item = TypeVar("Item", covariant=True)


class LoadChange(NamedTuple):
    """A task that left ``place`` with its load, or was put there.

    ``counts``: False where room is only kept for it.
    """

    place: int
    use: TaskUsage
    is_charge: bool
    counts: bool = True


@dataclass(slots=True, kw_only=True)
class PassMoment:
    """Gamma, and the tasks that the pass has put on each place, after the first ``step`` changes."""

    ledger: Ledger
    placed: dict[int, int] = field(default_factory=dict)
    step: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadHistory:
    """The changes of gamma in one pass, from ``start`` on, in order.

    ``moments`` are those last asked for: the ranking of the next task needs a few changes more.
    """

    start: Ledger
    changes: list[LoadChange] = field(default_factory=list)
    moments: list[PassMoment] = field(default_factory=list)

    def take_moment(self, step: int) -> PassMoment:
        """The moment after ``step`` changes, for this caller alone until it is put back into ``moments``."""
        try:
            moment = self.moments.pop()  # at once: two threads never hold the same one
        except IndexError:
            moment = PassMoment(ledger=self.start.copy())
        if moment.step > step:
            moment = PassMoment(ledger=self.start.copy())
        for place, use, is_charge, counts in self.changes[moment.step : step]:
            if is_charge:
                moment.ledger.charge(place, use)
                moment.placed[place] = moment.placed.get(place, 0) + counts
            else:
                moment.ledger.release(place, use)
        moment.step = step
        return moment


@dataclass(slots=True, kw_only=True)
class RankingRequest:
    """Whatever the ranking of one task is made of. ``step``: the changes of gamma before it.

    ``chosen``, ``stays``, ``barred``: as for ``rank_hosts`` and ``gather_candidates``.
    """

    context: AssignmentContext
    history: LoadHistory
    step: int
    task: Task
    incumbent: int | None
    predecessors: Mapping[str, int]
    stays: bool
    chosen: int | None
    barred: Mapping[int, Rejection] = field(default_factory=dict)
    made: tuple[tuple[RankedHost, ...], dict[str, int]] | None = None

    def make(self) -> tuple[tuple[RankedHost, ...], dict[str, int]]:
        """The ranking, and how many hosts it leaves out by rule; made once."""
        if self.made is None:
            moment = self.history.take_moment(self.step)
            candidates = gather_candidates(
                self.context,
                moment.ledger,
                self.task,
                incumbent=self.incumbent,
                predecessors=self.predecessors,
                placed=moment.placed,
                stays=self.stays,
                barred=self.barred,
            )
            self.made = rank_hosts(weigh_candidates(candidates), self.chosen)
            self.history.moments.append(moment)
        return self.made


class LazySequence(Sequence[Item]):
    """Items that ``_read`` makes when they are first read; equal to any sequence of the same."""

    __slots__ = ()

    @abstractmethod
    def _read(self) -> tuple[Item, ...]: ...

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Item, ...]: ...
    def __getitem__(self, index: int | slice) -> Item | tuple[Item, ...]:
        return self._read()[index]

    def __len__(self) -> int:
        return len(self._read())

    def __iter__(self) -> Iterator[Item]:
        return iter(self._read())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return repr(self._read())


class LazyRanking(LazySequence[RankedHost]):
    """The ranked hosts of one task."""

    __slots__ = ("_request",)

    def __init__(self, request: RankingRequest) -> None:
        self._request = request

    def _read(self) -> tuple[RankedHost, ...]:
        return self._request.make()[0]


class LazyDemands(LazySequence[ResourceDemand]):
    """What a task counts for at a place."""

    __slots__ = ("_made", "_place", "_request")

    def __init__(self, request: RankingRequest, place: int) -> None:
        self._made: tuple[ResourceDemand, ...] | None = None
        self._request = request
        self._place = place

    def _read(self) -> tuple[ResourceDemand, ...]:
        if self._made is None:
            fleet, task = self._request.context.fleet, self._request.task
            self._made = list_resource_demands(fleet, task, self._place)
        return self._made


class LazyCounts(Mapping[str, int]):
    """The hosts that a ranking leaves out, by rule, counted when they are first read."""

    __slots__ = ("_request",)

    def __init__(self, request: RankingRequest) -> None:
        self._request = request

    def __getitem__(self, rule: str) -> int:
        return self._request.make()[1][rule]

    def __len__(self) -> int:
        return len(self._request.make()[1])

    def __iter__(self) -> Iterator[str]:
        return iter(self._request.make()[1])

    def __repr__(self) -> str:
        return repr(self._request.make()[1])
