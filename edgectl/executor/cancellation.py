"""Why no further action begins: asked to stop, a failure under ``fail_fast``, or a deadline."""

import threading
import time

from edgectl.model.result import ActionResult, Outcome

INTERRUPTED = "interrupted before it began"


class Cancellation:
    """``stop_requested``: set from outside. ``deadline``: on the monotonic clock, None for none. From any thread."""

    def __init__(
        self, stop_requested: threading.Event, *, fail_fast: bool = False, deadline: float | None = None
    ) -> None:
        self._stop_requested = stop_requested
        self._fail_fast = fail_fast
        self._deadline = deadline
        self._failed = ""

    def seen(self, result: ActionResult | None) -> ActionResult | None:
        """Take note of how an action ended; the result itself."""
        if result is not None and result.outcome is Outcome.FAILED and not self._failed:
            self._failed = result.task
        return result

    def reason(self) -> str:
        """Why nothing may begin, empty while it may."""
        if self._stop_requested.is_set():
            return INTERRUPTED
        if self._fail_fast and self._failed:
            return f"not begun, because {self._failed} failed (--fail-fast)"
        late = self._deadline is not None and time.monotonic() >= self._deadline
        return "not begun before the deadline (--timeout)" if late else ""
