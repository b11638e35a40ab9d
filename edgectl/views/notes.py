# SPDX-License-Identifier: Apache-2.0
"""Notes below a table: lists in words, and what is wrong with a snapshot."""

from collections.abc import Collection, Iterable

from edgectl.model.snapshot import Snapshot, find_doubled_tasks
from edgectl.rules.lost_places import describe_lost_place, list_lost_tasks
from edgectl.views.state import format_silence
from edgectl.views.text import RenderOptions, escape_unprintable, style_text, wrap_text

# So many names of a list are given.
_MAX_NAMED = 5


def list_snapshot_notes(value: Snapshot) -> list[str]:
    """Why an answer is not complete or not well, which costs exit code 4: tasks that run twice, hosts without
    a reply, tasks where the inventory no longer reaches them.
    """
    return list_doubled_notes(value) + list_unreachable_notes(value) + list_lost_task_notes(value)


def list_doubled_notes(value: Snapshot) -> list[str]:
    """One line for each task that runs twice."""
    return [
        f"DOUBLED: {task} runs on {join_words(hosts)}; edgectl apply stops all but one"
        for task, hosts in find_doubled_tasks(value).items()
    ]


def list_unreachable_notes(value: Snapshot) -> list[str]:
    """One line for each host that does not answer, with the remedy."""
    contact = value.manager.contact if value.manager else {}
    return [
        f"{name} does not answer: {host.error or 'no cause given'}"
        + (f" ({host.hint})" if host.hint else "")
        + format_silence(contact.get(name), value.taken_at)
        for name, host in value.hosts.items()
        if not host.ok
    ]


def list_lost_task_notes(value: Snapshot, without: Collection[str] = ()) -> list[str]:
    """One line for each task whose place the inventory no longer reaches, except those of ``without``."""
    return [
        f"{task} {describe_lost_place(place)}"
        for task, place in list_lost_tasks(value).items()
        if task not in without
    ]


def render_notes(lines: Iterable[str], look: RenderOptions) -> str:
    """Each line as a note."""
    return "".join(
        style_text("note:", "warn", look)
        + wrap_text(f"note: {escape_unprintable(line)}", look).removeprefix("note:")
        for line in lines
    )


def join_first_words(words: Iterable[str]) -> str:
    """A list in words that names at most five: ``a, b, c, d, e and 7 more``. A host may report thousands."""
    listed = list(words)
    left = len(listed) - _MAX_NAMED
    return join_words([*listed[:_MAX_NAMED], *([f"{left} more"] if left > 0 else [])])


def join_words(words: Iterable[str]) -> str:
    """A list in words: ``a, b and c``."""
    *head, last = list(words) or [""]
    return f"{', '.join(head)} and {last}" if head else last
