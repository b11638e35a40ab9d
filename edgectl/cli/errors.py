# SPDX-License-Identifier: Apache-2.0
"""Conversion of exceptions into messages and exit codes."""

import errno
import os
import re
import shlex
from collections.abc import Sequence
from typing import Any

from edgectl.cli import console
from edgectl.errors import EdgectlError, ExitCode, InputError, UsageError
from edgectl.names import format_alternatives

# Typer's message for an unknown word, with its suggestions.
_TYPER_SUGGESTION = re.compile(r"(.+?)\.? \(?(?:Did you mean(?: one of:)?|Possible options:) (.+?)[?)]+")
# And for a word too many.
_EXTRA_WORDS = re.compile(r"Got unexpected extra arguments?(?:\(s\))? \((.+)\)")
_UNKNOWN_COMMAND = re.compile(r"No such command '(.+?)'")
# Options that sort and cut one table.
_OF_LISTS = ("--sort-by", "--field", "--no-headers", "-l")


def handle_error(error: Exception, words: Sequence[str]) -> int:
    """Print the error and return the exit code.

    Raises:
        Exception: the error itself, if it is a bug and EDGECTL_DEBUG is set.
    """
    known = error if isinstance(error, EdgectlError) else _usage_error_from_typer(error, words)
    if known is None:
        if os.environ.get("EDGECTL_DEBUG"):
            raise error
        known = _wrap_unexpected_error(error)
    print_error(known, words)
    # Of diff, 1 says that something differs.
    failed_diff = known.exit_code is ExitCode.FAILED and next(iter(words), "") == "diff"
    return ExitCode.DIFF_FAILED if failed_diff else known.exit_code


def _usage_error_from_typer(error: Exception, words: Sequence[str] = ()) -> UsageError | None:
    """Convert typer's usage errors and aborts, which have no public class, by exit code and class name."""
    if type(error).__name__ == "Abort":
        return UsageError("no answer on stdin", hint="pass --yes to continue without asking")
    if getattr(error, "exit_code", None) != ExitCode.CHANGES or not hasattr(error, "format_message"):
        return None
    context = getattr(error, "ctx", None)
    command = getattr(context, "command_path", "edgectl")
    if type(error).__name__ == "NoArgsIsHelpError":  # its message is the whole help
        words = list(context.command.commands) if context else []
        return UsageError(
            f"missing subcommand: {', '.join(f'{command.split()[-1]} {word}' for word in words)}",
            hint=f"run {command} {format_alternatives(words)}",
        )
    said = " ".join(error.format_message().split()).replace("a valid int range", "a whole number").rstrip(".")
    unknown = _UNKNOWN_COMMAND.match(said)
    if command == "edgectl describe" and unknown is not None:
        kinds = "edge|robot|task"
        return UsageError(
            f"{unknown[1]!r} is no kind", hint=f"name it: edgectl describe {kinds} {unknown[1]}"
        )
    guessed = _TYPER_SUGGESTION.fullmatch(said)
    problem = guessed[1] if guessed else said
    if command == "edgectl status" and problem.removeprefix("No such option: ") in _OF_LISTS:
        listed = shlex.join(["edgectl", "get", "tasks", *words[1:]])
        return UsageError(problem, hint=f"status is a report of several tables; a list takes it: {listed}")
    if guessed:
        return UsageError(
            problem,
            hint=f"did you mean {format_alternatives(guessed[2].replace(chr(39), '').split(', '))}?",
        )
    extra = _EXTRA_WORDS.fullmatch(said)
    if extra is not None:
        return UsageError(f"unexpected argument: {extra[1]}", hint=_suggest_each_name(context))
    if said.startswith("Missing argument"):
        return UsageError(said, hint=_suggest_example(context, command))
    if command == "edgectl" and said.startswith("No such option"):
        return UsageError(said, hint=_suggest_option_place(words))
    return UsageError(said, hint=f"see {command} --help")


def _suggest_example(context: Any, command: str) -> str:  # noqa: ANN401 - as above
    """The first example of the help."""
    lines = str(getattr(getattr(context, "command", None), "epilog", "") or "").splitlines()
    examples = [line.strip() for line in lines if line.strip().startswith("edgectl ")]
    return f"for example: {examples[0]}" if examples else f"see {command} --help"


def _suggest_each_name(context: Any) -> str:  # noqa: ANN401 - typer's, which has no public class
    """How a command that takes one name is called with many of them."""
    command = getattr(context, "command_path", "edgectl")
    parameters = getattr(getattr(context, "command", None), "params", ())
    taken = [str(each.metavar) for each in parameters if each.param_type_name == "argument"]
    if not taken or taken[0] not in ("TASK", "HOST"):
        return f"see {command} --help"
    several = f"xargs -I {taken[0]} {command} {' '.join(taken)}"
    return f"{command} takes one {' and one '.join(taken)}; for several: {several}"


def _suggest_option_place(words: Sequence[str]) -> str:
    """The same words with the command first: only options of every command may stand before it."""
    from edgectl.cli.app import COMMANDS

    groups = {name.partition(" ")[0] for name in COMMANDS}
    place = next((number for number, word in enumerate(words) if word in groups), 0)
    if not place:
        return "see edgectl --help"
    end = place + 1 + (" ".join(words[place : place + 2]) in COMMANDS)
    return (
        f"options follow the command: edgectl {shlex.join([*words[place:end], *words[:place], *words[end:]])}"
    )


def _wrap_unexpected_error(error: Exception) -> EdgectlError:
    if isinstance(error, OSError) and error.strerror:
        return _wrap_os_error(error, error.strerror)
    what = f"{type(error).__name__}: {error}".splitlines()[0]
    return EdgectlError(
        f"unexpected {what}", hint="this is a bug in edgectl; EDGECTL_DEBUG=1 shows where it happened"
    )


def _wrap_os_error(error: OSError, why: str) -> EdgectlError:
    """Convert operating system errors such as a full disk or missing permissions."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    hint = (
        "free some space; tasks on the hosts are not affected"
        if full
        else "EDGECTL_DEBUG=1 shows where it happened"
    )
    return EdgectlError(f"{error.filename}: {why}" if error.filename else why, hint=hint)


def print_error(error: EdgectlError, words: Sequence[str]) -> None:
    """Print an error on stderr, as JSON with ``-o json``.

    On stdout: annotations of ``-o github``, the report of ``-o gitlab``, and the problems of ``validate -o
    json``, which are its data.
    """
    from edgectl.views import errors, github, gitlab

    form = _find_output_format(words)
    if form == "github" and isinstance(error, InputError):
        console.print_text(github.problems(error.problems))
    elif form == "gitlab" and isinstance(error, InputError):
        console.print_text(gitlab.render_report(error.problems))
    elif form == "json":
        asked_for = isinstance(error, InputError) and "validate" in words[:3]
        (console.print_text if asked_for else console.print_stderr)(errors.render_error_json(error))
    else:
        console.print_stderr(errors.render_error(error, console.get_stderr_render_options()))


def _find_output_format(words: Sequence[str]) -> str:
    """The value of ``-o`` in the raw words: after a usage error nothing is parsed."""
    form = os.environ.get("EDGECTL_OUTPUT", "table")
    for word, following in zip(words, [*words, ""][1:], strict=True):
        if word in ("-o", "--output"):
            form = following
        elif word.startswith("--output="):
            form = word.removeprefix("--output=")
        elif word.startswith("-o") and not word.startswith("--"):
            form = word.removeprefix("-o").removeprefix("=")
    return form
