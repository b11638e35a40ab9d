# SPDX-License-Identifier: Apache-2.0
"""Installation of completion and manual pages for the user's shell."""

import os
from pathlib import Path

from edgectl.cli.user_files import PUBLIC_FILE_MODE, make_directory, save_file
from edgectl.errors import FileError, UsageError

# zsh loads a completion by the name of its file, and calls what the file is the body of.
_ZSH_CALL = '\n[ "${funcstack[1]}" = "_edgectl" ] && _edgectl_completion "$@"\n'
_ZSH_MARK = "# completion of edgectl"


def find_shell(given: str | None) -> str:
    """The given shell, or that of ``$SHELL``.

    Raises:
        UsageError: it is none for which there is a completion.
    """
    shell = given or Path(os.environ.get("SHELL", "")).name
    if shell not in ("bash", "zsh", "fish"):
        raise UsageError(
            f"no completion for the shell {shell or 'of $SHELL, which is not set'}",
            hint="name one: edgectl completion bash --install (or zsh, fish)",
        )
    return shell


def get_completion_text(shell: str) -> str:
    """The completion script of a shell."""
    from typer._completion_shared import get_completion_script

    return get_completion_script(prog_name="edgectl", complete_var="_EDGECTL_COMPLETE", shell=shell) + "\n"


def install_completion(shell: str) -> list[Path]:
    """Write the completion where the shell looks for it, and the manual pages; the files that were written.

    zsh has no such place for a user: one is added to its ``.zshrc``, once.

    Raises:
        FileError: one cannot be written.
    """
    from edgectl.cli.man_pages import build_man_pages

    data = _get_xdg_directory("XDG_DATA_HOME", ".local/share")
    text = get_completion_text(shell)
    written = []
    if shell == "bash":
        written.append(_write(data / "bash-completion" / "completions" / "edgectl", text))
    elif shell == "fish":
        config = _get_xdg_directory("XDG_CONFIG_HOME", ".config")
        written.append(_write(config / "fish" / "completions" / "edgectl.fish", text))
    else:
        written.append(_write(data / "zsh" / "site-functions" / "_edgectl", text + _ZSH_CALL))
        written += _add_to_zshrc(data / "zsh" / "site-functions")
    for name, page in build_man_pages().items():
        written.append(_write(data / "man" / "man1" / name, page))
    return written


def _get_xdg_directory(variable: str, default: str) -> Path:
    """A directory of the XDG base directory specification, which ignores relative ones."""
    named = os.environ.get(variable, "")
    return Path(named) if named.startswith("/") else Path.home() / default


def _write(path: Path, text: str) -> Path:
    make_directory(path.parent)
    save_file(path, text, mode=PUBLIC_FILE_MODE)
    return path


def _add_to_zshrc(functions: Path) -> list[Path]:
    path = Path(os.environ.get("ZDOTDIR") or Path.home()) / ".zshrc"
    try:
        before = path.read_text() if path.exists() else ""
        if _ZSH_MARK in before:
            return []
        with path.open("a") as file:
            file.write(f"\n{_ZSH_MARK}\nfpath=('{functions}' $fpath)\nautoload -Uz compinit && compinit\n")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"cannot add a line to {path}: {error}") from error
    return [path]
