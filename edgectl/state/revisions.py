# SPDX-License-Identifier: Apache-2.0
"""Revisions of a fleet, read from its journal. Fields that an older edgectl did not record stay empty."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TypeVar

from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, CarriedState, Outcome, Phase, PhaseResult
from edgectl.model.revision import Revision, RevisionOutcome
from edgectl.state.journal import JOURNAL_FILE_NAME
from edgectl.state.journal_reader import JournalEntry, read_journal
from edgectl.state.json_files import Warn, ignore_warning
from edgectl.state.open_work import SharedRevision
from edgectl.units import parse_instant

Word = TypeVar("Word", bound=StrEnum)
_ROTATED_NAME = re.compile(r"journal-([0-9]+)\.jsonl")
_CARRIED_SECONDS = ("save_s", "transfer_s", "load_s", "age_s")
# What other machines are told: so many of the newest revisions, with so many places in all.
_MAX_SHARED, _MAX_SHARED_PLACES = 16, 4096
_CUT_OFF_ERROR = "interrupted before it ended"


def load_revisions(fleet_dir: Path, warn: Warn = ignore_warning) -> tuple[Revision, ...]:
    """All readable revisions, oldest first, from the rotated journals and the present one.

    Raises:
        StateError: a journal cannot be read, or a newer edgectl wrote it.
    """
    put_away = sorted(
        (int(found[1]), path)
        for path in fleet_dir.glob("journal-*.jsonl")
        if (found := _ROTATED_NAME.fullmatch(path.name))
    )
    return _read_revisions((*(path for _, path in put_away), fleet_dir / JOURNAL_FILE_NAME), warn)


def collect_shared_revisions(
    fleet_dir: Path, known: Iterable[SharedRevision], machine: str
) -> tuple[SharedRevision, ...]:
    """The newest revisions as another machine has to know them to go back to one: those of the present
    journal, by a user of this ``machine``, and those that are ``known`` to be shared.
    """
    own = _read_revisions((fleet_dir / JOURNAL_FILE_NAME,), ignore_warning)
    found = {each.number: each for each in (*known, *(_build_shared_revision(each, machine) for each in own))}
    newest, room = list[SharedRevision](), _MAX_SHARED_PLACES
    for number in sorted(found, reverse=True)[:_MAX_SHARED]:
        each = found[number]
        room -= len(each.placements or ())
        newest.append(each if room >= 0 else replace(each, placements=None))
    return tuple(reversed(newest))


def _build_shared_revision(each: Revision, machine: str) -> SharedRevision:
    return SharedRevision(
        number=each.number,
        began_at=each.began_at,
        user=each.user if "@" in each.user else f"{each.user}@{machine}",
        verb=each.verb,
        ending=each.ending.value,
        seconds=each.seconds,
        counts=each.counts,
        placements=each.placements,
    )


def _read_revisions(paths: Iterable[Path], warn: Warn) -> tuple[Revision, ...]:
    """Those of this machine, and those that it knows from others only, where their numbers belong."""
    opened, others = list[_OpenRevision](), dict[int, Revision]()
    for path in paths:
        log = read_journal(path, partial(_add_entry, opened, others))
        if log.broken:
            warn(f"{path} is damaged at line {log.broken}; the revisions around it may be incomplete")
    own = list(map(_build_revision, opened))
    foreign = [others[number] for number in others.keys() - {each.number for each in own}]
    return tuple(sorted((*own, *foreign), key=lambda each: each.number)) if foreign else tuple(own)


@dataclass(slots=True)
class _OpenRevision:
    """A revision under construction."""

    begin: JournalEntry
    intents: dict[str, JournalEntry] = field(default_factory=dict)
    ended: dict[str, JournalEntry] = field(default_factory=dict)
    end: JournalEntry | None = None
    placements: dict[str, str] | None = None


def _add_entry(found: list[_OpenRevision], others: dict[int, Revision], entry: JournalEntry) -> None:
    event = entry.get("event")
    if event == "handover":
        shared = entry.get("revisions")
        for each in map(_object_or_empty, shared if isinstance(shared, list) else []):
            if number := _positive_int_or_zero(each.get("number")):
                others[number] = _decode_shared_revision(number, each)
        return
    if event == "begin" and _positive_int_or_zero(entry.get("revision")):
        found.append(_OpenRevision(entry))
    elif found:
        _update_open_revision(found[-1], str(event), entry)


def _update_open_revision(current: _OpenRevision, event: str, entry: JournalEntry) -> None:
    task = str(entry.get("task"))
    if event == "intent":
        current.intents[task] = entry
    elif event in ("commit", "skipped"):
        current.ended[task] = {**current.intents.pop(task, {}), **entry}
    elif event == "end":
        current.end = entry
    elif event == "placed" and entry.get("revision") == current.begin.get("revision"):
        current.placements = {
            name: str(host) for name, host in _object_or_empty(entry.get("placements")).items()
        }


def _build_revision(found: _OpenRevision) -> Revision:
    actions = (
        *(_decode_action_result(entry) for entry in found.ended.values()),
        *(_decode_action_result(entry, cut_off=True) for entry in found.intents.values()),
    )
    counts = {
        name: _positive_int_or_zero(count)
        for name, count in _object_or_empty(found.begin.get("counts")).items()
    }
    return Revision(
        number=_positive_int_or_zero(found.begin.get("revision")),
        began_at=_instant_or_zero(found.begin.get("at")),
        verb=_text_or_empty(found.begin.get("verb")),
        user=_text_or_empty(found.begin.get("user")),
        ending=_determine_ending(found, actions),
        seconds=_compute_duration_s(found),
        counts=counts or Counter(action.action.value for action in actions),
        actions=actions,
        placements=found.placements,
    )


def _decode_shared_revision(number: int, entry: JournalEntry) -> Revision:
    placements, counts = entry.get("placements"), _object_or_empty(entry.get("counts"))
    return Revision(
        number=number,
        began_at=_finite_or_none(entry.get("began_at")) or 0.0,
        user=_text_or_empty(entry.get("user")),
        verb=_text_or_empty(entry.get("verb")),
        ending=_decode_enum(RevisionOutcome, entry.get("ending"), RevisionOutcome.CUT_OFF),
        seconds=_finite_or_none(entry.get("seconds")),
        counts={name: _positive_int_or_zero(count) for name, count in counts.items()},
        placements={name: str(host) for name, host in placements.items()}
        if isinstance(placements, dict)
        else None,
    )


def _determine_ending(found: _OpenRevision, actions: tuple[ActionResult, ...]) -> RevisionOutcome:
    if found.end is None:
        return RevisionOutcome.CUT_OFF
    if found.end.get("interrupted") is True:
        return RevisionOutcome.INTERRUPTED
    done = sum(action.outcome is Outcome.DONE for action in actions)
    if done == len(actions):
        return RevisionOutcome.DONE
    return RevisionOutcome.PARTLY if done else RevisionOutcome.FAILED


def _compute_duration_s(found: _OpenRevision) -> float | None:
    """Duration as recorded, else (in an older journal) by the clock."""
    if found.end is None:
        return None
    stated = _finite_or_none(found.end.get("seconds"))
    return (
        max(0.0, _instant_or_zero(found.end.get("at")) - _instant_or_zero(found.begin.get("at")))
        if stated is None
        else stated
    )


def _decode_action_result(entry: JournalEntry, *, cut_off: bool = False) -> ActionResult:
    phases = entry.get("phases")
    return ActionResult(
        task=_text_or_empty(entry.get("task")),
        action=_decode_enum(Action, entry.get("action"), Action.NONE),
        outcome=Outcome.FAILED if cut_off else _decode_enum(Outcome, entry.get("outcome"), Outcome.FAILED),
        host=_text_or_empty(entry.get("host")) or None,
        previous_host=_text_or_empty(entry.get("previous_host")) or None,
        phases=tuple(_decode_phase_result(phase) for phase in phases if isinstance(phase, dict))
        if isinstance(phases, list)
        else (),
        downtime_s=_finite_or_none(entry.get("downtime_s")),
        gap_s=_finite_or_none(entry.get("gap_s")),
        error=_CUT_OFF_ERROR if cut_off else _text_or_empty(entry.get("error")),
        located=_text_or_empty(entry.get("located")) or None,
        state=_decode_carried_state(entry.get("state")),
    )


def _decode_carried_state(value: object) -> CarriedState | None:
    """The state that a move took along; None where it took none."""
    if not isinstance(value, dict):
        return None
    seconds = {key: _finite_or_none(value.get(key)) or 0.0 for key in _CARRIED_SECONDS}
    return CarriedState(
        host=_text_or_empty(value.get("host")),
        size_bytes=_positive_int_or_zero(value.get("bytes")),
        sent_bytes=_positive_int_or_zero(value.get("sent")),
        sha256=_text_or_empty(value.get("sha256")),
        **seconds,
    )


def _decode_phase_result(entry: JournalEntry) -> PhaseResult:
    return PhaseResult(
        phase=_decode_enum(Phase, entry.get("phase"), Phase.SAFE),
        host=_text_or_empty(entry.get("host")),
        seconds=_finite_or_none(entry.get("seconds")) or 0.0,
        ok=entry.get("ok") is True,
        detail=_text_or_empty(entry.get("detail")),
    )


def _decode_enum(kind: type[Word], value: object, otherwise: Word) -> Word:
    return kind(value) if isinstance(value, str) and value in {word.value for word in kind} else otherwise


def _text_or_empty(value: object) -> str:
    return value if isinstance(value, str) else ""


def _positive_int_or_zero(value: object) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else 0


def _finite_or_none(value: object) -> float | None:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if good and isinstance(value, int | float) else None


def _object_or_empty(value: object) -> Mapping[str, object]:
    return value if isinstance(value, dict) else {}


def _instant_or_zero(value: object) -> float:
    try:
        return parse_instant(value)
    except ValueError:
        return 0.0
