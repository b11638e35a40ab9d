"""Run a command in the environment and the folder of a running task: the program of ``edgectl exec``.

Its text is sent to the host and run there by Python 3.6 or later, so it imports nothing of edgectl. It
becomes the command: input, output, terminal and exit code are the command's own.
"""
# ruff: noqa: PTH119, PTH123, PTH208, S606 - without pathlib, whose import takes as long as all the rest

import base64
import json
import os
import sys

_SHELLS = ("sh", "bash", "dash", "zsh", "ksh", "ash")
# Marks every process of a task. A command without it is no part of the task: a stop leaves it alone, and it
# does not keep the task from being stopped.
_MARK = "EDGECTL_TASK_DIR"
# Of the terminal at hand, not of the task.
_OWN_VARIABLES = ("TERM", "COLORTERM", "LANG", "LC_ALL", "LC_CTYPE", "SSH_TTY", "SSH_CONNECTION")
# As a shell and env end: cannot be run, not found, and a failure of ours.
NOT_EXECUTABLE, NOT_FOUND, FAILED = 126, 127, 125


def read_environment(pid: int) -> "dict[str, str]":
    """The environment of a process of this user, as it was when its program began; empty if it is gone."""
    try:
        with open(f"/proc/{pid}/environ", "rb") as file:
            entries = file.read().decode("utf-8", "surrogateescape").split("\0")
    except OSError:
        return {}
    return dict(entry.split("=", 1) for entry in entries if "=" in entry)


def list_children(pid: int) -> "list[int]":
    """The children of a process, oldest first."""
    found = []
    for name in os.listdir("/proc"):
        if name.isdigit():
            try:
                with open(f"/proc/{name}/stat", "rb") as file:
                    parent = int(file.read().rpartition(b")")[2].split()[1])
            except (OSError, ValueError, IndexError):
                continue
            if parent == pid:
                found.append(int(name))
    return sorted(found)


def find_program(pid: int) -> int:
    """The process whose environment the task's program has: below the shells that source set-up files."""
    for _ in range(8):
        try:
            with open(f"/proc/{pid}/comm") as file:
                shell = file.read().strip() in _SHELLS
        except OSError:
            return pid
        below = [child for child in list_children(pid) if _MARK in read_environment(child)] if shell else []
        if not below:
            return pid
        pid = below[0]
    return pid


def enter_task(task: str, pid: int, argv: "list[str]") -> int:
    """Become ``argv`` beside process ``pid`` of ``task``; returns only where that fails."""
    if os.path.basename(read_environment(pid).get(_MARK, "")) != task:
        sys.stderr.write(f"error: {task} ended meanwhile\n")
        return FAILED
    program = find_program(pid)
    env = read_environment(program)
    env.pop(_MARK, None)
    env.update({name: os.environ[name] for name in _OWN_VARIABLES if name in os.environ})
    try:
        os.chdir(f"/proc/{program}/cwd")
        os.environ.clear()
        os.environ.update(env)
        os.execvp(argv[0], argv)
    except (FileNotFoundError, NotADirectoryError):
        sys.stderr.write(f"error: {argv[0]}: command not found\n")
        return NOT_FOUND
    except OSError as error:
        sys.stderr.write(f"error: {argv[0]}: {error.strerror}\n")
        return NOT_EXECUTABLE


if __name__ == "__main__":
    asked = json.loads(base64.b64decode(sys.argv[1]).decode())
    sys.exit(enter_task(asked["task"], asked["pid"], asked["argv"]))
