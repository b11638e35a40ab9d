# SPDX-License-Identifier: Apache-2.0
"""Entry point: build the command, run it, and end with the right exit code and never with a traceback.

Nothing is imported here that ``edgectl --help`` does not need.
"""

import atexit
import contextlib
import gc
import itertools
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from edgectl.module_cache import install_module_cache

_INTERRUPTED = 130  # ExitCode.INTERRUPTED
# Objects that Python's collector of garbage tracks; an apply has 90,000 at its first connection.
_FIRST_COLLECTION = 150_000
_INSECURE_FILES = "--insecure-files"
# Kinds of describe by their other forms.
_DESCRIBED = {form: kind for kind in ("edge", "robot", "task") for form in (kind, f"{kind}s", kind[0])}
# Options of every command that have a value.
_WITH_VALUE = ("--context", "--color", "--log-format")
_ALONE = (_INSECURE_FILES, "-v", "-vv", "--verbose")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code (docs/cli.md, "Exit codes")."""
    words = list(sys.argv[1:] if argv is None else argv)
    _postpone_garbage_collection()
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


def run() -> NoReturn:
    """Be the program ``edgectl``: ``main``, with modules from one file, and an end without a teardown."""
    _replace_closed_streams()
    modules = install_module_cache()
    code = main()
    with contextlib.suppress(KeyboardInterrupt):
        modules.update()
    atexit.register(_end_process, code)
    sys.exit(code)


def _end_process(code: int) -> None:
    """End after all other functions of the end, without Python's teardown, which takes 7 ms (ADR 209)."""
    atexit.unregister(_end_process)
    # As multiprocessing ends its processes.
    atexit._run_exitfuncs()  # noqa: SLF001
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (KeyboardInterrupt, OSError, ValueError):
        return  # Python tries once more, and has an exit code for it
    os._exit(code)


def _postpone_garbage_collection() -> None:
    """Let the first collection wait for so many objects that no start has them; then it is as usual.

    What is imported is no garbage, and the collector went through it a hundred times (ADR 164).
    """
    usual = gc.get_threshold()
    if not 0 < usual[0] < _FIRST_COLLECTION:
        return

    def restore(*_: object) -> None:
        gc.callbacks.remove(restore)
        gc.set_threshold(*usual)

    gc.callbacks.append(restore)
    gc.set_threshold(_FIRST_COLLECTION, *usual[1:])


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
    from edgectl.deferred_imports import import_deferred

    import_deferred("typer.main")
    from typer.main import get_command

    from edgectl.cli.app import build_app
    from edgectl.cli.console import guard_standard_streams

    code: object = 0
    own, others = split_global_options(words)
    others = expand_shorthand(others)
    if _INSECURE_FILES in own:
        os.environ["EDGECTL_INSECURE_FILES"] = "1"
    with guard_standard_streams():
        try:
            command = get_command(build_app(others))
            code = command.main(
                args=[*own, *others],
                prog_name="edgectl",
                standalone_mode=False,
                default_map=_load_option_defaults(command, others),
            )
        except SystemExit:
            # the only exit that typer makes by itself: the reader of the help is gone
            raise BrokenPipeError from None
    return code if isinstance(code, int) else 0


def _load_option_defaults(command: Any, words: Sequence[str]) -> dict[str, Any] | None:  # noqa: ANN401
    """Defaults of the options of a command that reads a fleet, by project and user, as click takes them."""
    path = []
    for word in words:
        if word in getattr(command, "commands", ()):
            command = command.commands[word]
            path.append(word)
    reads_fleet = any(parameter.name == "inventory" for parameter in command.params)
    if not reads_fleet or "-h" in words or "--help" in words or "_EDGECTL_COMPLETE" in os.environ:
        return None
    from edgectl.cli.project import load_option_defaults

    defaults: dict[str, Any] = load_option_defaults()
    for name in reversed(path):
        defaults = {name: defaults}
    return defaults


def split_global_options(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """The options of every command, which may stand anywhere, with their values; and all other words."""
    own, others = [], []
    rest = iter(words)
    for word in rest:
        if word == "--":
            others += [word, *rest]
        elif word in _WITH_VALUE:
            own += [word, *itertools.islice(rest, 1)]
        elif word in _ALONE or word.partition("=")[0] in _WITH_VALUE:
            own.append(word)
        else:
            others.append(word)
    return own, others


def expand_shorthand(words: Sequence[str]) -> list[str]:
    """Expand the calls that have no command of their own.

    None is the help, as is ``help [COMMAND]``; ``top`` is ``top hosts``, and ``top -i`` is ``top hosts -I``
    (after ``hosts``, ``-i`` names the inventory as everywhere). ``simulate SCENARIO`` is ``simulate run``.
    ``describe`` takes a kind in all its forms, and KIND/NAME as ``-o name`` prints it.
    """
    match list(words):
        case []:
            return ["--help"]
        case ["help", *rest]:
            return [*rest, "--help"]
        case ["top", "-i" | "-I" | "--interactive", *rest]:
            return ["top", "hosts", "-I", *rest]
        case ["top"]:
            return ["top", "hosts"]
        case ["top", option, *rest] if option.startswith("-") and option not in ("-h", "--help"):
            return ["top", "hosts", option, *rest]
        case ["describe", word, *rest] if "/" in word:
            kind, _, name = word.partition("/")
            # Of other kinds, which -o name prints too, the command finds what they are.
            named = [_DESCRIBED[kind], name] if kind in _DESCRIBED else ["edge", word]
            return ["describe", *named, *rest]
        case ["describe", word, *rest] if word in _DESCRIBED:
            return ["describe", _DESCRIBED[word], *rest]
        case ["simulate", word, *rest] if word not in ("run", "sweep", "merge", "-h", "--help"):
            return ["simulate", "run", word, *rest]
        case others:
            return others
