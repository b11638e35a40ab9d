"""The journal, read as a list of revisions. What an older edgectl did not write yet is left open, never guessed."""

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TypeVar

from edgectl.model.plan import Action
from edgectl.model.result import ActionResult, Outcome, Phase, PhaseResult
from edgectl.model.revision import Ending, Revision
from edgectl.state.files import Warn, silent
from edgectl.state.journal import NAME
from edgectl.state.journal_read import Entry, read
from edgectl.units import parse_instant

Word = TypeVar("Word", bound=StrEnum)
_PUT_AWAY = re.compile(r"journal-([0-9]+)\.jsonl")
_CUT_OFF = "cut off before it ended"


def revisions(fleet_dir: Path, warn: Warn = silent) -> tuple[Revision, ...]:
    """Every revision that can be read, oldest first, from the journals that were put away and the present one.

    Raises:
        StateError: a journal cannot be read, or a newer edgectl wrote it.
    """
    put_away = sorted((int(found[1]), path) for path in fleet_dir.glob("journal-*.jsonl") if (found := _PUT_AWAY.fullmatch(path.name)))
    opened: list[_Open] = []
    for path in (*(path for _, path in put_away), fleet_dir / NAME):
        log = read(path, partial(_note, opened))
        if log.broken:
            warn(f"{path} is damaged at line {log.broken}; the revisions around it may be incomplete")
    return tuple(map(_revision, opened))


@dataclass(slots=True)
class _Open:
    """One revision while its entries are read."""

    begin: Entry
    intents: dict[str, Entry] = field(default_factory=dict)
    ended: dict[str, Entry] = field(default_factory=dict)
    end: Entry | None = None
    placements: dict[str, str] | None = None


def _note(found: list[_Open], entry: Entry) -> None:
    event = entry.get("event")
    if event == "begin" and _whole(entry.get("revision")):
        found.append(_Open(entry))
    elif found:
        _take(found[-1], str(event), entry)


def _take(current: _Open, event: str, entry: Entry) -> None:
    task = str(entry.get("task"))
    if event == "intent":
        current.intents[task] = entry
    elif event in ("commit", "skipped"):
        current.ended[task] = {**current.intents.pop(task, {}), **entry}
    elif event == "end":
        current.end = entry
    elif event == "placed" and entry.get("revision") == current.begin.get("revision"):
        current.placements = {name: str(host) for name, host in _object(entry.get("placements")).items()}


def _revision(found: _Open) -> Revision:
    actions = (*(_action(entry) for entry in found.ended.values()), *(_action(entry, cut_off=True) for entry in found.intents.values()))
    counts = {name: _whole(count) for name, count in _object(found.begin.get("counts")).items()}
    return Revision(
        number=_whole(found.begin.get("revision")),
        began_at=_instant(found.begin.get("at")),
        verb=_text(found.begin.get("verb")),
        user=_text(found.begin.get("user")),
        ending=_ending(found, actions),
        seconds=_seconds(found),
        counts=counts or Counter(action.action.value for action in actions),
        actions=actions,
        placements=found.placements,
    )


def _ending(found: _Open, actions: tuple[ActionResult, ...]) -> Ending:
    if found.end is None:
        return Ending.CUT_OFF
    if found.end.get("interrupted") is True:
        return Ending.INTERRUPTED
    done = sum(action.outcome is Outcome.DONE for action in actions)
    if done == len(actions):
        return Ending.DONE
    return Ending.PARTLY if done else Ending.FAILED


def _seconds(found: _Open) -> float | None:
    """How long it took: as written, else (an older journal) from the clock."""
    if found.end is None:
        return None
    stated = _number(found.end.get("seconds"))
    return max(0.0, _instant(found.end.get("at")) - _instant(found.begin.get("at"))) if stated is None else stated


def _action(entry: Entry, *, cut_off: bool = False) -> ActionResult:
    phases = entry.get("phases")
    return ActionResult(
        task=_text(entry.get("task")),
        action=_word(Action, entry.get("action"), Action.NONE),
        outcome=Outcome.FAILED if cut_off else _word(Outcome, entry.get("outcome"), Outcome.FAILED),
        host=_text(entry.get("host")) or None,
        previous_host=_text(entry.get("previous_host")) or None,
        phases=tuple(_phase(phase) for phase in phases if isinstance(phase, dict)) if isinstance(phases, list) else (),
        downtime_s=_number(entry.get("downtime_s")),
        error=_CUT_OFF if cut_off else _text(entry.get("error")),
        located=_text(entry.get("located")) or None,
    )


def _phase(entry: Entry) -> PhaseResult:
    return PhaseResult(
        phase=_word(Phase, entry.get("phase"), Phase.SAFE),
        host=_text(entry.get("host")),
        seconds=_number(entry.get("seconds")) or 0.0,
        ok=entry.get("ok") is True,
    )


def _word(kind: type[Word], value: object, otherwise: Word) -> Word:
    return kind(value) if isinstance(value, str) and value in {word.value for word in kind} else otherwise


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _whole(value: object) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else 0


def _number(value: object) -> float | None:
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if good and isinstance(value, int | float) else None


def _object(value: object) -> Mapping[str, object]:
    return value if isinstance(value, dict) else {}


def _instant(value: object) -> float:
    try:
        return parse_instant(value)
    except ValueError:
        return 0.0
