"""How a command ends that did not go well: one form for every error, and its exit code."""

import errno
import os
import re
from collections.abc import Sequence

from edgectl.cli import console
from edgectl.errors import EdgectlError, ExitCode, InputError, UsageError
from edgectl.names import format_alternatives

# What typer says of a word that it does not know, with those that were meant.
_TYPER_SUGGESTION = re.compile(r"(.+?)\.? \(?(?:Did you mean(?: one of:)?|Possible options:) (.+?)[?)]+")


def handle_error(error: Exception, words: Sequence[str]) -> int:
    """Say what went wrong. The result is the exit code.

    Raises:
        Exception: the error itself, where it is a bug and EDGECTL_DEBUG asks to see it.
    """
    known = error if isinstance(error, EdgectlError) else _usage_error_from_typer(error)
    if known is None:
        if os.environ.get("EDGECTL_DEBUG"):
            raise error
        known = _wrap_unexpected_error(error)
    print_error(known, words)
    return known.exit_code


def _usage_error_from_typer(error: Exception) -> UsageError | None:
    """Typer's usage errors and its aborts carry no public class, but an exit code or a name."""
    if type(error).__name__ == "Abort":
        return UsageError("no answer on standard input", hint="pass --yes to go on without a question")
    if getattr(error, "exit_code", None) != ExitCode.CHANGES or not hasattr(error, "format_message"):
        return None
    context = getattr(error, "ctx", None)
    command = getattr(context, "command_path", "edgectl")
    if type(error).__name__ == "NoArgsIsHelpError":  # its message is the whole help
        words = list(context.command.commands) if context else []
        return UsageError(
            f"{command} needs a further word", hint=f"write {command} {format_alternatives(words)}"
        )
    said = " ".join(error.format_message().split()).replace("a valid int range", "a whole number").rstrip(".")
    if guessed := _TYPER_SUGGESTION.fullmatch(said):
        return UsageError(
            guessed[1],
            hint=f"did you mean {format_alternatives(guessed[2].replace(chr(39), '').split(', '))}?",
        )
    return UsageError(said, hint=f"see {command} --help")


def _wrap_unexpected_error(error: Exception) -> EdgectlError:
    if isinstance(error, OSError) and error.strerror:
        return _wrap_os_error(error, error.strerror)
    what = f"{type(error).__name__}: {error}".splitlines()[0]
    return EdgectlError(
        f"unexpected {what}", hint="this is a bug in edgectl; EDGECTL_DEBUG=1 shows where it happened"
    )


def _wrap_os_error(error: OSError, why: str) -> EdgectlError:
    """A full disk or a right that is missing is no bug of ours."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    hint = (
        "free some space; what runs on the hosts is not affected"
        if full
        else "EDGECTL_DEBUG=1 shows where it happened"
    )
    return EdgectlError(f"{error.filename}: {why}" if error.filename else why, hint=hint)


def print_error(error: EdgectlError, words: Sequence[str]) -> None:
    """Text on standard error; JSON there where ``-o json`` was asked for. On standard output: annotations for ``-o github``, and
    what ``validate -o json`` found, which is its data.
    """
    from edgectl.views import errors, github

    form = _find_output_format(words)
    if form == "github" and isinstance(error, InputError):
        console.print_text(github.problems(error.problems))
    elif form == "json":
        asked_for = isinstance(error, InputError) and "validate" in words[:1]
        (console.print_text if asked_for else console.print_stderr)(errors.render_error_json(error))
    else:
        console.print_stderr(errors.render_error(error, console.get_stderr_render_options()))


def _find_output_format(words: Sequence[str]) -> str:
    """What ``-o`` says, read from the words: a usage error leaves nothing parsed."""
    form = os.environ.get("EDGECTL_OUTPUT", "table")
    for word, following in zip(words, [*words, ""][1:], strict=True):
        if word in ("-o", "--output"):
            form = following
        elif word.startswith("--output="):
            form = word.removeprefix("--output=")
        elif word.startswith("-o") and not word.startswith("--"):
            form = word.removeprefix("-o").removeprefix("=")
    return form
