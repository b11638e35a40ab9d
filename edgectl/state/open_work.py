# SPDX-License-Identifier: Apache-2.0
"""Open work of a manager's journal, for whoever changes the fleet next, on any machine (ADR 176)."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, field, replace
from pathlib import Path

from edgectl.dataclass import dataclass
from edgectl.model.encoding import in_document
from edgectl.state.journal import JOURNAL_FILE_NAME, Journal
from edgectl.state.journal_reader import JournalEntry, read_journal_cached
from edgectl.state.json_files import Warn, ignore_warning

# Of the plans that were applied, so many of the newest are shared: none may be applied twice.
_MAX_APPLIED = 64
_LEAVING_PHASES = ("hold", "save", "transfer")


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedRevision:
    """A revision without its actions, in the words of `edgectl.model.revision.Revision`."""

    number: int = field(metadata=in_document(required=True))
    began_at: float = 0.0
    user: str = ""
    verb: str = ""
    ending: str = ""
    seconds: float | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    placements: Mapping[str, str] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenWork:
    """The part of a journal that another machine has to know.

    ``revision``: number of the newest apply. ``applied``: ids of the newest plans, in order. ``unfinished``:
    tasks that a run has begun to change, or may have. ``held``: tasks whose robot is on hold. ``spooled``: by
    task, the hosts that may keep its state for a move. ``revisions``: the newest ones, without their actions.
    """

    revision: int = 0
    applied: tuple[str, ...] = ()
    unfinished: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    spooled: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    revisions: tuple[SharedRevision, ...] = ()


def has_to_be_shared(entry: JournalEntry) -> bool:
    """Whether this entry of a journal leaves something that another machine must know before it is done: a
    robot on hold, or released, or a state that a host keeps.
    """
    opens = entry.get("event") == "phase" and entry.get("phase") in _LEAVING_PHASES
    return opens or entry.get("event") == "released"


def add_announcement(work: OpenWork, revision: int, plan_id: str, tasks: Iterable[str]) -> OpenWork:
    """``work`` once a run begins that may change ``tasks``."""
    return replace(
        work,
        revision=revision,
        applied=(*work.applied, plan_id)[-_MAX_APPLIED:],
        unfinished=tuple(dict.fromkeys((*work.unfinished, *tasks))),
    )


def collect_open_work(fleet_dir: Path) -> OpenWork:
    """What the journal of this machine leaves; without revisions."""
    log = read_journal_cached(fleet_dir / JOURNAL_FILE_NAME)
    return OpenWork(
        revision=log.revision,
        applied=tuple(log.known)[-_MAX_APPLIED:],
        unfinished=log.unfinished,
        held=log.held,
        spooled=log.spooled,
    )


def take_over_work(
    fleet_dir: Path, left: OpenWork, known: OpenWork, clock: Callable[[], float], warn: Warn = ignore_warning
) -> None:
    """Continue the journal of this machine with what another one has ``left``. What of its own was never
    shared stays; ``known``: what it shared, or took over, last.

    Call it within the fleet's lock.

    Raises:
        StateError: the journal cannot be read or written.
    """
    own = collect_open_work(fleet_dir)
    unknown = _select_unknown(fleet_dir, left.revisions)
    kept = {task: hosts for task, hosts in own.spooled.items() if task not in known.spooled}
    merged = replace(
        left,
        revision=max(left.revision, own.revision),
        unfinished=_add_own(left.unfinished, own.unfinished, known.unfinished),
        held=_add_own(left.held, own.held, known.held),
        spooled={**left.spooled, **kept},
        revisions=unknown,
    )
    if merged == own:
        return
    with Journal.open(fleet_dir, clock=clock, warn=warn) as journal:
        journal.append(
            "handover",
            revision=merged.revision,
            applied=list(merged.applied),
            unfinished=list(merged.unfinished),
            held=list(merged.held),
            spooled={task: list(hosts) for task, hosts in merged.spooled.items()},
            revisions=[asdict(each) for each in unknown],
        )


def _select_unknown(fleet_dir: Path, shared: tuple[SharedRevision, ...]) -> tuple[SharedRevision, ...]:
    if not shared:
        return ()
    # Not before: most commands never come here.
    from edgectl.state.revisions import load_revisions

    numbers = {each.number for each in load_revisions(fleet_dir)}
    return tuple(each for each in shared if each.number not in numbers)


def _add_own(left: tuple[str, ...], own: tuple[str, ...], known: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*left, *(task for task in own if task not in known))))
