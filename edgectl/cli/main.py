"""Entry point: build the command, run it, and end with the right exit code and never with a traceback.

Nothing is imported here that ``edgectl --help`` does not need.
"""

import os
import sys
from collections.abc import Sequence

_INTERRUPTED = 130  # ExitCode.INTERRUPTED
_INSECURE_FILES = "--insecure-files"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code (docs/cli.md, "Exit codes")."""
    words = list(sys.argv[1:] if argv is None else argv)
    _replace_closed_streams()
    try:
        code = _run_command(words)
    except KeyboardInterrupt:
        code = _INTERRUPTED
    except Exception as error:
        from edgectl.cli.errors import handle_error

        return handle_error(error, words)
    if code == _INTERRUPTED:
        sys.stderr.write("interrupted\n")
    return code


def _replace_closed_streams() -> None:
    """Open /dev/null for standard streams that the caller closed, before another file or socket gets their
    number.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)
            os.set_inheritable(number, True)  # noqa: FBT003
            setattr(sys, name, open(number, "w" if number else "r", encoding="utf-8", closefd=False))  # noqa: SIM115


def _run_command(words: list[str]) -> int:
    from typer.main import get_command

    from edgectl.cli.app import build_app
    from edgectl.cli.console import guard_standard_streams

    code: object = 0
    args = expand_shorthand(move_global_options(words))
    with guard_standard_streams():
        try:
            code = get_command(build_app(args)).main(args=args, prog_name="edgectl", standalone_mode=False)
        except SystemExit:
            # the only exit that typer makes by itself: the reader of the help is gone
            raise BrokenPipeError from None
    return code if isinstance(code, int) else 0


def move_global_options(words: Sequence[str]) -> list[str]:
    """``--insecure-files``, which may stand anywhere, before the command."""
    end = words.index("--") if "--" in words else len(words)
    others = [word for word in words[:end] if word != _INSECURE_FILES]
    moved = [_INSECURE_FILES] if others and len(others) < end else []
    return [*moved, *others, *words[end:]]


def expand_shorthand(words: Sequence[str]) -> list[str]:
    """Expand the calls that have no command of their own.

    None is the help, as is ``help [COMMAND]``; ``top`` is ``top hosts``, and ``top -i`` is ``top hosts -I``
    (after ``hosts``, ``-i`` names the inventory as everywhere).
    """
    match list(words):
        case []:
            return ["--help"]
        case [option, *rest] if option == _INSECURE_FILES:
            return [option, *expand_shorthand(rest)]
        case ["help", *rest]:
            return [*rest, "--help"]
        case ["top", "-i" | "-I" | "--interactive", *rest]:
            return ["top", "hosts", "-I", *rest]
        case ["top"]:
            return ["top", "hosts"]
        case ["top", option, *rest] if option.startswith("-") and option not in ("-h", "--help"):
            return ["top", "hosts", option, *rest]
        case others:
            return others
