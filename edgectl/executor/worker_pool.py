# SPDX-License-Identifier: Apache-2.0
"""Parallel work in the order of its dependencies; progress is reported in the caller's thread."""

import queue
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from types import MappingProxyType

from edgectl.model.progress import ProgressEvent, ProgressListener
from edgectl.model.result import ActionResult

ResultsByTask = Mapping[str, ActionResult]
WorkFunction = Callable[[str, ResultsByTask], ActionResult | None]
_WorkEnd = tuple[str, ActionResult | None, BaseException | None]
_WAKE_S, _GROUP_PART = 0.2, 4
_NO_GROUPS: Mapping[str, str] = MappingProxyType({})


class WorkerPool:
    """Daemon threads, at most ``size`` at once: a second Ctrl-C need not wait for a host that hangs.

    ``report_progress`` may be called from any thread; ``listener`` is called in the thread of ``run_all``.
    """

    def __init__(self, size: int, stopped: Callable[[], object], listener: ProgressListener) -> None:
        self._size = size
        self._stopped = stopped
        self._listener = listener
        self._events: queue.SimpleQueue[ProgressEvent | _WorkEnd] = queue.SimpleQueue()

    def report_progress(self, event: ProgressEvent) -> None:
        """Pass an event to the listener."""
        self._events.put(event)

    def run_all(
        self,
        after: Mapping[str, frozenset[str]],
        work: WorkFunction,
        skip: Callable[[str], ActionResult | None],
        groups: Mapping[str, str] = _NO_GROUPS,
    ) -> dict[str, ActionResult]:
        """Do ``work(name, results so far)`` for each name once all in ``after[name]`` have ended.

        Names that have not begun once ``stopped`` are given to ``skip``. Work that returns None has no
        result. Of one of ``groups`` at most a quarter of the workers are busy at once, and at least one.
        """
        waiting, running, ended = dict(after), set[str](), dict[str, ActionResult]()
        while waiting or running:
            if waiting and self._stopped():
                skipped = {name: skip(name) for name in waiting}
                ended |= {name: result for name, result in skipped.items() if result is not None}
                waiting.clear()
            for name in self._ready(waiting, running, groups):
                del waiting[name]
                running.add(name)
                threading.Thread(target=self._do, args=(work, name, dict(ended)), daemon=True).start()
            self._take_event(running, ended)
        while not self._events.empty():
            self._take_event(running, ended)
        return ended

    def _ready(
        self, waiting: Mapping[str, frozenset[str]], running: set[str], groups: Mapping[str, str]
    ) -> list[str]:
        unfinished, most = waiting.keys() | running, max(1, self._size // _GROUP_PART)
        busy = Counter(groups[name] for name in running if name in groups)
        ready = list[str]()
        for name, others in waiting.items():
            group = groups.get(name)
            if others & unfinished or (group is not None and busy[group] >= most):
                continue
            if group is not None:
                busy[group] += 1
            ready.append(name)
        return ready[: max(0, self._size - len(running))]

    def _do(self, work: WorkFunction, name: str, results: ResultsByTask) -> None:
        try:
            self._events.put((name, work(name, results), None))
        except BaseException as error:  # handed to the caller's thread
            self._events.put((name, None, error))

    def _take_event(self, running: set[str], ended: dict[str, ActionResult]) -> None:
        """Wait a moment for one event and handle it."""
        try:
            event = self._events.get(timeout=_WAKE_S)
        except queue.Empty:
            return
        if isinstance(event, ProgressEvent):
            self._listener(event)
            return
        name, result, error = event
        if error is not None:
            raise error
        running.discard(name)
        if result is not None:
            ended[name] = result
