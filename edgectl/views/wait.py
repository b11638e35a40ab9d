# SPDX-License-Identifier: Apache-2.0
"""Tasks that somebody waits for, as they were seen last."""

from collections.abc import Sequence

from edgectl.formats.document import Document
from edgectl.rules.awaited_state import AwaitedState, TaskProgress
from edgectl.views.glossary import head
from edgectl.views.output import ListView
from edgectl.views.output_format import NAMED_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, render_columns

_HEAD = head("task", "state", "host")


class WaitView(ListView):
    """Each task with the state that was seen last."""

    kind = "awaited-task"
    formats = NAMED_FORMATS

    def __init__(self, progress: Sequence[TaskProgress], awaited: AwaitedState) -> None:
        self._progress = progress
        self._awaited = awaited

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per task."""
        rows = [
            (Cell(each.task, "name"), Cell(each.state, "good" if each.reached else "warn"), each.host or "-")
            for each in self._progress
        ]
        return render_columns([_HEAD, *rows], look)

    def warnings(self) -> Sequence[str]:
        """What has not been reached."""
        left = (each for each in self._progress if not each.reached)
        return [f"{describe_progress(each)}, not {self._awaited}" for each in left]

    def items(self) -> Sequence[Document]:
        """The tasks as JSON types."""
        return [
            {
                "task": each.task,
                "awaited": self._awaited.value,
                "reached": each.reached,
                "state": each.state,
                "host": each.host,
            }
            for each in self._progress
        ]

    def names(self) -> Sequence[str]:
        """The tasks that have reached it, as task/NAME."""
        return [f"task/{each.task}" for each in self._progress if each.reached]


def describe_progress(progress: TaskProgress) -> str:
    """``task/slam ready on edge1``."""
    where = f" on {progress.host}" if progress.host is not None else ""
    return f"task/{progress.task} {progress.state}{where}"
