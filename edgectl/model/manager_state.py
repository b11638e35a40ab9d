"""State of the manager between runs: a cache and a history, not the record of what runs."""

from collections.abc import Mapping
from dataclasses import field

from edgectl.dataclass import dataclass
from edgectl.model.encoding import Instant, in_document

_WRITTEN = in_document(always=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement:
    """Last known place of a task: ``since`` (s since 1970) is when it came to that host.

    ``instance``: the start that was placed there; empty where it is not known.
    ``file``: the task file that last listed it. ``address`` and ``machine``: of the host, as in its sample.
    ``nodes``: the names and addresses of its ROS 1 nodes there.
    """

    host: str
    since: Instant
    spec_hash: str = field(default="", metadata=in_document(always=True))
    generation: int = field(default=0, metadata=in_document(always=True))
    instance: str = ""
    file: str = ""
    address: str = ""
    machine: str = ""
    nodes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pin:
    """The mark of ``edgectl move``: a task belongs on ``host`` from ``since`` on (ADR 140).

    ``until``: when it ends (s since 1970); None: with ``edgectl unpin``. ``machine``: of the host, as in its
    sample, by which it is found under a new name.
    """

    host: str
    since: Instant
    until: Instant | None = field(default=None, metadata=in_document("pinned_until"))
    machine: str = ""

    def is_active(self, now: float) -> bool:
        """Whether it holds at ``now`` (s since 1970)."""
        return self.until is None or now < self.until


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredDemand:
    """Usage of one task on one class of hosts: p95 of the newest samples by resource.

    Of the network, on each of its links. ``samples`` of them over ``span_s`` seconds. The network is absent
    where no traffic was seen (only TCP can be). ``spec_hash``: the specification that ran; empty: not known.
    """

    samples: int
    span_s: float
    used: Mapping[str, float] = field(metadata=in_document(by_resource=("used",)))
    spec_hash: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ManagerState:
    """State of the manager between two runs.

    ``managed``: this manager has applied a plan to this fleet before. ``placements``: last known place of
    each task. ``first``: the first placement ever made (policy static). ``cordons``: hosts closed to new
    work. ``draining``: cordoned hosts whose tasks must leave. ``done``: completed tasks by the spec hash that
    completed. ``downtimes``: measured handoff downtimes in seconds by task and host, newest last. ``stays``:
    how long each task stayed on the hosts that it has moved away from, in seconds, newest last. ``contact``:
    when each host was last in touch (s since 1970, the manager's clock): never earlier than the last request
    that may have reached it. ``fenced``: hosts that the operator declared switched off; a host that answers
    is not. ``deferred``: tasks whose last action was put off with nothing touched, and why. ``measured``: by
    task and class of host, of the tasks whose demand is not all declared. ``orphans``: by host, the tasks
    that had no supervisor there when it last answered. ``synced``: by host, the number of its grant when this
    manager last saw all hosts and noted what runs where. ``noise``: standard deviation of the readings by
    host and resource, as a share of the capacity, where it is high enough to widen the slack. ``pins``: the
    host of each task that an operator has moved by hand, also after their end.
    """

    managed: bool = field(default=False, metadata=_WRITTEN)
    placements: Mapping[str, Placement] = field(default_factory=dict, metadata=_WRITTEN)
    first: Mapping[str, str] = field(default_factory=dict, metadata=_WRITTEN)
    cordons: frozenset[str] = field(default=frozenset(), metadata=_WRITTEN)
    draining: frozenset[str] = field(default=frozenset(), metadata=_WRITTEN)
    done: Mapping[str, str] = field(default_factory=dict, metadata=_WRITTEN)
    downtimes: Mapping[tuple[str, str], tuple[float, ...]] = field(
        default_factory=dict,
        metadata=in_document(always=True, entries=("task", "host"), value_key="seconds"),
    )
    stays: Mapping[str, tuple[float, ...]] = field(default_factory=dict, metadata=_WRITTEN)
    contact: Mapping[str, Instant] = field(default_factory=dict, metadata=_WRITTEN)
    fenced: frozenset[str] = field(default=frozenset(), metadata=_WRITTEN)
    deferred: Mapping[str, str] = field(default_factory=dict, metadata=_WRITTEN)
    measured: Mapping[tuple[str, str], MeasuredDemand] = field(
        default_factory=dict, metadata=in_document(always=True, entries=("task", "class"))
    )
    orphans: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    synced: Mapping[str, int] = field(default_factory=dict)
    noise: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    pins: Mapping[str, Pin] = field(default_factory=dict)
