# SPDX-License-Identifier: Apache-2.0
"""Snapshot and plan files: fast if they are valid; otherwise every fault with its position."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from edgectl.config.json_positions import find_json_positions
from edgectl.config.problems import Mark, ProblemCode, Problems, Source, mark_from_span
from edgectl.config.source import STDIN, read_source, read_stdin
from edgectl.errors import EdgectlError
from edgectl.formats.document import Fault, FormatErrors
from edgectl.formats.kinds import PLAN_KIND, SNAPSHOT_KIND
from edgectl.model.plan import Plan
from edgectl.model.snapshot import Snapshot

MAX_DOCUMENT_BYTES = 256 * 2**20
_SNAPSHOT_COMMAND, _PLAN_COMMAND = "edgectl probe --out", "edgectl plan --out"
_PRINT_COMMANDS = {_SNAPSHOT_COMMAND: "edgectl probe -o json", _PLAN_COMMAND: "edgectl plan -o json"}
Model = TypeVar("Model")


def load_snapshot(path: str | Path) -> Snapshot:
    """The snapshot in a file, or on standard input (``-``).

    Raises:
        InputError: everything that is wrong with it.
    """
    return _load_document(Path(path), SNAPSHOT_KIND.decode, _SNAPSHOT_COMMAND, Problems())


def load_snapshots(paths: Iterable[Path]) -> tuple[Snapshot, ...]:
    """The snapshots in files, and in every ``.json`` file of directories.

    Raises:
        InputError: everything that is wrong with one of them.
    """
    files = (file for path in paths for file in (sorted(path.glob("*.json")) if path.is_dir() else [path]))
    return tuple(load_snapshot(file) for file in files)


def load_plan(path: str | Path) -> Plan:
    """The plan in a file, or on standard input (``-``).

    Raises:
        InputError: everything that is wrong with it.
    """
    return read_plan(Path(path), Problems())


def read_plan(path: Path, problems: Problems) -> Plan:
    """The plan in a file, or on standard input (``-``); ``problems`` collects the warnings.

    Raises:
        InputError: everything that is wrong with it.
    """
    return _load_document(path, PLAN_KIND.decode, _PLAN_COMMAND, problems)


class _NotJsonError(Exception):
    """The text is not the JSON that we read."""


def _load_document(path: Path, decode: Callable[[object], Model], again: str, problems: Problems) -> Model:
    maker = _PRINT_COMMANDS[again] if path == STDIN else f"{again} {path}"
    source = (
        read_stdin(problems, max_bytes=MAX_DOCUMENT_BYTES)
        if path == STDIN
        else read_source(path, problems, max_bytes=MAX_DOCUMENT_BYTES, maker=maker)
    )
    if source is None:
        problems.check()
        raise EdgectlError(f"{path} cannot be read")
    try:
        raw = _parse_json(source.text)
    except json.JSONDecodeError as error:
        mark = Mark(source, error.lineno, error.colno)
        _raise_problem(problems, mark, f"not JSON: {error.msg}", f"write it again: {maker}")
    except (ValueError, RecursionError, _NotJsonError) as error:
        _raise_text_problems(source, error, problems)
    try:
        return decode(raw)
    except FormatErrors as error:
        _reject_other_kind(source, raw, again, problems)
        _add_faults(source, error.faults, problems)
        problems.check()
        raise


def _parse_json(text: str) -> Any:  # noqa: ANN401 - JSON is anything
    """The value, or an error for what JSON readers disagree about: NaN, duplicate keys, endless nesting."""
    value = json.loads(text, parse_constant=_reject_constant, object_pairs_hook=_reject_duplicate_keys)
    if "\\ud" in text or "\\uD" in text:
        json.dumps(value, ensure_ascii=False).encode()  # half a surrogate pair is no text: a ValueError
    return value


def _reject_constant(word: str) -> NoReturn:
    raise _NotJsonError(word)


def _reject_duplicate_keys(pairs: list[tuple[str, object]]) -> dict[str, object]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise _NotJsonError("duplicate key")
    return value


def _raise_problem(problems: Problems, mark: Mark, message: str, hint: str) -> NoReturn:
    problems.add(mark, ProblemCode.JSON, message, hint)
    problems.check()
    raise EdgectlError(message, hint=hint)


def _raise_text_problems(source: Source, error: Exception, problems: Problems) -> NoReturn:
    if isinstance(error, RecursionError):
        _raise_problem(problems, Mark(source, 1, 1), "nested too deep", "check that it is the right file")
    places = find_json_positions(source.text, ())
    for span in places.constants:
        message = f"{source.text[slice(*span)][:20]} is not a finite number"
        problems.add(
            mark_from_span(source, *span),
            ProblemCode.JSON,
            message,
            "write a finite number, or remove the key",
        )
    for first, second in places.duplicates:
        line = mark_from_span(source, *first).line
        message = f"duplicate key {source.text[slice(*second)]} (first defined on line {line})"
        problems.add(
            mark_from_span(source, *second), ProblemCode.DUPLICATE_KEY, message, "remove one of the two"
        )
    problems.check()
    _raise_problem(problems, Mark(source, 1, 1), f"not JSON: {error}", "check that it is the right file")


def _reject_other_kind(source: Source, raw: object, again: str, problems: Problems) -> None:
    """A plan where a snapshot is wanted, or the other way round: one mistake, not one for each key."""
    keys = set(raw) & {"hosts", "decisions"} if isinstance(raw, dict) else set()
    if keys == {"hosts"} and again == _PLAN_COMMAND:
        _raise_problem(
            problems,
            Mark(source, 1, 1),
            "this is a snapshot, not a plan",
            f"plan from it: edgectl plan --snapshot {source.file}",
        )
    if keys == {"decisions"} and again == _SNAPSHOT_COMMAND:
        _raise_problem(
            problems,
            Mark(source, 1, 1),
            "this is a plan, not a snapshot",
            f"write a snapshot: {_SNAPSHOT_COMMAND} FILE",
        )


def _add_faults(source: Source, faults: tuple[Fault, ...], problems: Problems) -> None:
    places = find_json_positions(source.text, {fault.path for fault in faults})
    for fault in faults:
        mark = mark_from_span(source, *places.spans.get(fault.path, (0, 1)))
        problems.add(
            mark, ProblemCode.DOCUMENT, str(fault), fault.hint or "correct the value, or make the file again"
        )
