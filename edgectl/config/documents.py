"""Snapshot and plan files: fast where they are right; where they are not, every mistake with its place."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from edgectl.config.jsonplaces import find_places
from edgectl.config.problems import Code, Mark, Problems, Source, mark_of
from edgectl.config.source import read_source
from edgectl.errors import EdgectlError
from edgectl.formats import plan as plan_format
from edgectl.formats import snapshot as snapshot_format
from edgectl.formats.base import Fault, FormatErrors
from edgectl.model.plan import Plan
from edgectl.model.snapshot import Snapshot

MAX_BYTES = 256 * 2**20
_SNAPSHOT, _PLAN = "edgectl probe --out", "edgectl plan --out"
Model = TypeVar("Model")


def load_snapshot(path: str | Path) -> Snapshot:
    """The snapshot in a file.

    Raises:
        InputError: everything that is wrong with it.
    """
    return _load(Path(path), snapshot_format.decode, _SNAPSHOT)


def load_snapshots(paths: Iterable[Path]) -> tuple[Snapshot, ...]:
    """The snapshots in files, and in every ``.json`` file of directories.

    Raises:
        InputError: everything that is wrong with one of them.
    """
    files = (file for path in paths for file in (sorted(path.glob("*.json")) if path.is_dir() else [path]))
    return tuple(load_snapshot(file) for file in files)


def load_plan(path: str | Path) -> Plan:
    """The plan in a file.

    Raises:
        InputError: everything that is wrong with it.
    """
    return _load(Path(path), plan_format.decode, _PLAN)


class _NotJsonError(Exception):
    """The text is not the JSON that we read."""


def _load(path: Path, decode: Callable[[object], Model], again: str) -> Model:
    problems = Problems()
    source = read_source(path, problems, max_bytes=MAX_BYTES, maker=f"{again} {path}")
    if source is None:
        problems.check()
        raise EdgectlError(f"{path} cannot be read")
    try:
        raw = _parse(source.text)
    except json.JSONDecodeError as error:
        mark = Mark(source, error.lineno, error.colno)
        _refuse(problems, mark, f"not JSON: {error.msg}", f"write the file again with {again} {path}")
    except (ValueError, RecursionError, _NotJsonError) as error:
        _refuse_text(source, error, problems)
    try:
        return decode(raw)
    except FormatErrors as error:
        _refuse_the_other_kind(source, raw, again, problems)
        _note_faults(source, error.faults, problems)
        problems.check()
        raise


def _parse(text: str) -> Any:  # noqa: ANN401 - JSON is anything
    """The value, or an error for what JSON readers disagree about: NaN, keys that stand twice, endless nesting."""
    value = json.loads(text, parse_constant=_no_constant, object_pairs_hook=_no_duplicates)
    if "\\ud" in text or "\\uD" in text:
        json.dumps(value, ensure_ascii=False).encode()  # half a surrogate pair is no text: a ValueError
    return value


def _no_constant(word: str) -> NoReturn:
    raise _NotJsonError(word)


def _no_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise _NotJsonError("duplicate key")
    return value


def _refuse(problems: Problems, mark: Mark, message: str, hint: str) -> NoReturn:
    problems.add(mark, Code.JSON, message, hint)
    problems.check()
    raise EdgectlError(message, hint=hint)


def _refuse_text(source: Source, error: Exception, problems: Problems) -> NoReturn:
    if isinstance(error, RecursionError):
        _refuse(problems, Mark(source, 1, 1), "nested too deep", "check that it is the right file")
    places = find_places(source.text, ())
    for span in places.constants:
        message = f"{source.text[slice(*span)][:20]} is not a finite number"
        problems.add(mark_of(source, *span), Code.JSON, message, "write a finite number, or remove the key")
    for first, second in places.twice:
        line = mark_of(source, *first).line
        message = f"{source.text[slice(*second)]} stands twice in this object, first on line {line}"
        problems.add(mark_of(source, *second), Code.DUPLICATE_KEY, message, "remove one of the two")
    problems.check()
    _refuse(problems, Mark(source, 1, 1), f"not JSON: {error}", "check that it is the right file")


def _refuse_the_other_kind(source: Source, raw: object, again: str, problems: Problems) -> None:
    """A plan where a snapshot is wanted, or the other way round: one mistake, not one for each key."""
    keys = set(raw) & {"hosts", "decisions"} if isinstance(raw, dict) else set()
    if keys == {"hosts"} and again == _PLAN:
        _refuse(problems, Mark(source, 1, 1), "this is a snapshot, not a plan", f"plan from it: edgectl plan --snapshot {source.file}")
    if keys == {"decisions"} and again == _SNAPSHOT:
        _refuse(problems, Mark(source, 1, 1), "this is a plan, not a snapshot", f"write a snapshot: {_SNAPSHOT} FILE")


def _note_faults(source: Source, faults: tuple[Fault, ...], problems: Problems) -> None:
    places = find_places(source.text, {fault.path for fault in faults})
    for fault in faults:
        mark = mark_of(source, *places.spans.get(fault.path, (0, 1)))
        problems.add(mark, Code.DOCUMENT, str(fault), fault.hint or "correct the value, or make the file again")
