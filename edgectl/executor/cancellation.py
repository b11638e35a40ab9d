# SPDX-License-Identifier: Apache-2.0
"""Reasons for which no further action begins: an interruption, a failure under ``fail_fast``, a deadline."""

import time

from edgectl.executor.run_options import RunOptions
from edgectl.model.result import ActionResult, Outcome

INTERRUPTED = "interrupted before it began"


class Cancellation:
    """The stop condition of one run; may be asked from any thread."""

    def __init__(self, options: RunOptions) -> None:
        self._options = options
        self._failed = ""

    def note_result(self, result: ActionResult | None) -> ActionResult | None:
        """Take note of how an action ended; the result itself."""
        if result is not None and result.outcome is Outcome.FAILED and not self._failed:
            self._failed = result.task
        return result

    def reason(self) -> str:
        """The reason why nothing may begin, empty while it may."""
        if self._options.stop_requested.is_set():
            return INTERRUPTED
        if self._options.fail_fast and self._failed:
            return f"not begun, because {self._failed} failed (--fail-fast)"
        deadline = self._options.deadline
        late = deadline is not None and time.monotonic() >= deadline
        return "not begun before the deadline (--timeout)" if late else ""
