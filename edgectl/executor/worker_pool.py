"""Pieces of work in parallel, each after those it waits for; progress comes out in the caller's thread."""

import queue
import threading
from collections.abc import Callable, Mapping

from edgectl.model.progress import ProgressEvent, ProgressListener
from edgectl.model.result import ActionResult

ResultsByTask = Mapping[str, ActionResult]
WorkFunction = Callable[[str, ResultsByTask], ActionResult | None]
_WorkEnd = tuple[str, ActionResult | None, BaseException | None]
_WAKE_S = 0.2


class WorkerPool:
    """Daemon threads, at most ``size`` at once: a second Ctrl-C need not wait for a host that hangs.

    ``tell`` may be called from any thread; ``listener`` hears it in the thread of ``work``.
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
        self, after: Mapping[str, frozenset[str]], work: WorkFunction, skip: Callable[[str], ActionResult]
    ) -> dict[str, ActionResult]:
        """Do ``work(name, results so far)`` for each name once all in ``after[name]`` have ended; ``skip`` what is left once ``stopped``.

        Work that returns None leaves its name out of the results.
        """
        waiting, running, ended = dict(after), set[str](), dict[str, ActionResult]()
        while waiting or running:
            if waiting and self._stopped():
                ended |= {name: skip(name) for name in waiting}
                waiting.clear()
            for name in self._ready(waiting, running):
                del waiting[name]
                running.add(name)
                threading.Thread(target=self._do, args=(work, name, dict(ended)), daemon=True).start()
            self._hear(running, ended)
        while not self._events.empty():
            self._hear(running, ended)
        return ended

    def _ready(self, waiting: Mapping[str, frozenset[str]], running: set[str]) -> list[str]:
        unfinished = waiting.keys() | running
        ready = [name for name, others in waiting.items() if not others & unfinished]
        return ready[: max(0, self._size - len(running))]

    def _do(self, work: WorkFunction, name: str, results: ResultsByTask) -> None:
        try:
            self._events.put((name, work(name, results), None))
        except BaseException as error:  # handed to the caller's thread
            self._events.put((name, None, error))

    def _hear(self, running: set[str], ended: dict[str, ActionResult]) -> None:
        """Wait a moment for one event and take it in."""
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
