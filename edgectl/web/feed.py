# SPDX-License-Identifier: Apache-2.0
"""The latest document of the fleet, made by one loop for all viewers."""

import gzip
import json
import threading
import time
from collections.abc import Callable

from edgectl.dataclass import dataclass
from edgectl.errors import EdgectlError
from edgectl.formats.document import Document

# Without a viewer for so long, hosts are left alone until one comes.
IDLE_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Publication:
    """One result of the loop, counted by ``number``.

    ``version`` counts documents: it stays where a probe failed (``error``), and so do ``body`` (JSON),
    ``packed`` (the same by gzip) and ``made_at``, the monotonic time of that probe.
    """

    number: int
    version: int
    made_at: float
    body: bytes = b""
    packed: bytes = b""
    error: str = ""


class FleetFeed:
    """Documents made every ``every`` seconds while somebody looks, and once at the beginning.

    ``now`` is a monotonic clock in s. ``run`` belongs into a thread; all else is for any number of them.
    """

    def __init__(
        self,
        make: Callable[[], Document],
        *,
        every: float,
        idle_s: float = IDLE_S,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.every = every
        self._make, self._idle_s, self._now = make, idle_s, now
        self._changed = threading.Condition()
        self._latest = Publication(number=0, version=0, made_at=0.0)
        self._asked_at = now()
        self._ended = threading.Event()

    def run(self) -> None:
        """Make documents until ``stop``."""
        while not self._ended.is_set():
            began = self._now()
            publication = self._renew()
            with self._changed:
                if self._ended.is_set():
                    return
                self._latest = publication
                self._changed.notify_all()
                self._changed.wait_for(self._ended.is_set, max(0.0, began + self.every - self._now()))
                self._changed.wait_for(lambda: self._ended.is_set() or self._is_asked())

    def _is_asked(self) -> bool:
        return self._now() - self._asked_at < self._idle_s

    def _renew(self) -> Publication:
        before = self._latest
        number = before.number + 1
        try:
            body = json.dumps(self._make(), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        except Exception as error:  # one probe failed; the page says so and shows the one before
            why = error.message if isinstance(error, EdgectlError) else f"unexpected {type(error).__name__}"
            return Publication(
                number=number,
                version=before.version,
                made_at=before.made_at,
                body=before.body,
                packed=before.packed,
                error=why,
            )
        data = body.encode("utf-8", "backslashreplace")
        packed = gzip.compress(data, 5, mtime=0)
        return Publication(
            number=number, version=before.version + 1, made_at=self._now(), body=data, packed=packed
        )

    def get_latest(self) -> Publication:
        """The latest publication; ``version`` 0: there is no document yet."""
        return self.wait_newer(-1, 0.0)

    def wait_newer(self, number: int, timeout: float) -> Publication:
        """The latest publication, as soon as it is newer than ``number``, the feed stops or the time is
        over.
        """
        with self._changed:
            self._asked_at = self._now()
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._ended.is_set() or self._latest.number > number, timeout)
            return self._latest

    def describe(self, publication: Publication) -> Document:
        """The event for viewers: version of the document, its age in s, and why it is not newer."""
        age = self._now() - publication.made_at if publication.version else None
        return {
            "version": publication.version,
            "age_s": None if age is None else round(age, 3),
            "period_s": self.every,
            "error": publication.error,
        }

    @property
    def ended(self) -> bool:
        """Whether it was stopped."""
        return self._ended.is_set()

    def stop(self) -> None:
        """End the loop after the probe in progress, and every wait at once."""
        with self._changed:
            self._ended.set()
            self._changed.notify_all()
