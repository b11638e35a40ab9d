# SPDX-License-Identifier: Apache-2.0
"""Results of ``edgectl events test``: one line for each program of ``on_event``."""

from collections.abc import Sequence

from edgectl.formats.document import Document
from edgectl.model.event import EventHook
from edgectl.units import format_duration
from edgectl.views.glossary import head
from edgectl.views.marks import DRY_RUN_SUFFIX
from edgectl.views.output import ListView
from edgectl.views.output_format import ITEM_FORMATS
from edgectl.views.text import PLAIN, Cell, RenderOptions, Row, render_columns


class HookTrialsView(ListView):
    """Hooks with the reason of their failure (empty: none) and their duration in s."""

    kind = "hook"
    formats = ITEM_FORMATS

    def __init__(self, trials: Sequence[tuple[EventHook, str, float]], *, dry_run: bool = False) -> None:
        """``dry_run``: none of them was run."""
        self._trials, self._dry_run = trials, dry_run

    def table(self, look: RenderOptions = PLAIN) -> str:
        """One line per hook."""
        if self._dry_run:
            return "".join(f"{name_program(hook)} run{DRY_RUN_SUFFIX}\n" for hook, _, _ in self._trials)
        rows: list[Row] = [
            (
                name_program(hook),
                Cell("failed" if why else "done", "bad" if why else "good"),
                format_duration(seconds),
                why or "-",
            )
            for hook, why, seconds in self._trials
        ]
        return render_columns([head("command", "outcome", "duration_s", "message"), *rows], look, wrap={3})

    def items(self) -> Sequence[Document]:
        """The trials as JSON types."""
        return [
            {
                "command": name_program(hook),
                "outcome": "skipped" if self._dry_run else "failed" if why else "done",
                "duration_s": round(seconds, 3),
                "message": why,
            }
            for hook, why, seconds in self._trials
        ]


def name_program(hook: EventHook) -> str:
    """The program of a hook without its arguments, or its notifier."""
    return hook.command[0] if hook.command else f"notifier {hook.notifier}"
