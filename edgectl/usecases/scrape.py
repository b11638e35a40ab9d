# SPDX-License-Identifier: Apache-2.0
"""Metrics of the fleet for Prometheus, from one probe shared by all scrapes."""

import contextlib
import dataclasses
import threading
import time
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from edgectl import __version__
from edgectl.export.metric_samples import MetricsInput
from edgectl.gateway.host_probe import ProbeOptions
from edgectl.model.revision import Revision
from edgectl.state.manager_state import StateFingerprint, fingerprint_state_files
from edgectl.transport.connections import REFUSED_BACKOFF_S, BackoffTransport, SessionPool
from edgectl.usecases.fleet import Fleet
from edgectl.usecases.history import list_revisions
from edgectl.usecases.plan import make_plan
from edgectl.usecases.probe import probe_fleet

Value = TypeVar("Value")


def collect_fleet_metrics(
    fleet: Fleet, options: ProbeOptions, past: Callable[[], tuple[Revision, ...]] | None = None
) -> MetricsInput:
    """Probe, plan as an unattended apply would, and take earlier actions from ``past``, else from the
    journal.
    """
    snapshot = probe_fleet(fleet, options)
    policy = dataclasses.replace(fleet.tasks.policy, attended=False)
    done = past() if past is not None else list_revisions(fleet)
    return MetricsInput(
        version=__version__,
        snapshot=snapshot,
        plan=make_plan(fleet, policy, snapshot=snapshot),
        revisions=done,
    )


class RevisionCache:
    """Cache of the revisions, reread only where the journal changed: a long journal takes a while. For one
    thread at a time.
    """

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._stamp: StateFingerprint | None = None
        self._revisions: tuple[Revision, ...] = ()

    def __call__(self) -> tuple[Revision, ...]:
        """Every revision, oldest first."""
        now = fingerprint_state_files(self._fleet.state)
        if now != self._stamp:
            self._revisions, self._stamp = list_revisions(self._fleet), now
        return self._revisions


@contextlib.contextmanager
def keep_sessions_open(fleet: Fleet) -> Iterator[Fleet]:
    """The fleet over sessions that stay open from scrape to scrape; an unreachable host is retried with
    back-off.
    """
    with SessionPool(fleet.transport, forget_s=REFUSED_BACKOFF_S, converse=True) as pool:
        yield dataclasses.replace(fleet, transport=BackoffTransport(pool))


class SharedCache(Generic[Value]):
    """A value made at most once every ``every`` seconds, and once for all concurrent callers.

    An error is shared like a value. ``now`` is a monotonic clock in s.
    """

    def __init__(
        self, make: Callable[[], Value], *, every: float, now: Callable[[], float] = time.monotonic
    ) -> None:
        self._make, self._every, self._now = make, every, now
        self._guard = threading.Lock()
        self._made = 0
        self._made_at = 0.0
        self._value: Value | None = None
        self._error: Exception | None = None

    def __call__(self) -> Value:
        """The present value: of the call in progress, or at most ``every`` seconds old.

        Raises:
            Exception: what ``make`` raised.
        """
        seen = self._made
        with self._guard:
            if self._made == seen and not self._fresh():
                self._renew()
            if self._error is not None:
                raise self._error.with_traceback(None)
            return self._value  # type: ignore[return-value]

    def _fresh(self) -> bool:
        return self._made > 0 and self._now() - self._made_at < self._every

    def _renew(self) -> None:
        self._value = self._error = None
        try:
            self._value = self._make()
        except Exception as error:  # raised to every waiting caller
            self._error = error
        self._made += 1
        self._made_at = self._now()
