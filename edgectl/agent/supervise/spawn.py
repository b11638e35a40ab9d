# SPDX-License-Identifier: Apache-2.0
"""Start of a command in a clean process: signals, descriptors and session of supervisor and task."""

import _signal as signal
import os

from ..link import fast_json
from ..link.fast_json import Document
from . import shell

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, NoReturn, Union

_PR_SET_NAME, _PR_SET_CHILD_SUBREAPER = 15, 36
_MAX_FDS = 1 << 16


def clean_process(keep: "tuple[int, ...]") -> None:
    """Turn this process into a daemon: default signals, umask 077, directory /, no descriptors but ``keep``,
    subreaper of its tree.
    """
    reset_signals()
    os.umask(0o077)
    os.chdir("/")
    null = os.open(os.devnull, os.O_RDWR)
    for fd in (0, 1, 2):
        os.dup2(null, fd)
    close_other_fds({0, 1, 2} | set(keep))
    _call_prctl(_PR_SET_NAME, b"edgectl-task")
    if _call_prctl(_PR_SET_CHILD_SUBREAPER, 1) != 0:
        raise OSError("this kernel has no child subreaper")


def _call_prctl(option: int, argument: "Union[int, bytes]") -> int:
    """Call prctl(2): 0 where it succeeds.

    By the C half of module ctypes alone: the whole takes 5 ms of CPU at each start of a task.
    """
    arguments = (option, argument, 0, 0, 0)
    try:
        from _ctypes import call_function, dlopen, dlsym
    except ImportError:
        import ctypes

        return int(ctypes.CDLL(None).prctl(*arguments))
    program = dlopen(None, 0)  # type: ignore[arg-type] # typeshed wants a name; None is this program
    return int(call_function(dlsym(program, "prctl"), arguments))


def reset_signals() -> None:
    """Reset every disposition to its default and unblock all: a login by SSH or nohup may have left INT
    ignored.
    """
    for number in range(1, signal.NSIG):
        try:
            signal.signal(number, signal.SIG_DFL)
        except (OSError, ValueError):
            continue
    signal.pthread_sigmask(signal.SIG_SETMASK, set())


def close_other_fds(keep: "set[int]") -> None:
    """Close every descriptor but ``keep``."""
    try:
        fds = [int(name) for name in os.listdir("/proc/self/fd")]
    except OSError:
        fds = list(range(min(_MAX_FDS, os.sysconf("SC_OPEN_MAX"))))
    for fd in fds:
        if fd not in keep:
            try:
                os.close(fd)
            except OSError:
                continue


def run_detached(work: "Callable[[], None]", report: int, keep: "tuple[int, ...]") -> None:
    """Run ``work`` in a process of a session of its own, with nothing open but ``keep``.

    ``report`` is closed here.
    """
    child = os.fork()
    if child == 0:
        _run_as_daemon(work, report, keep)
    os.close(report)
    os.waitpid(child, 0)


def _run_as_daemon(work: "Callable[[], None]", report: int, keep: "tuple[int, ...]") -> "NoReturn":
    """In the first child: a new session, a second fork, a clean process."""
    try:
        os.setsid()
        if os.fork() == 0:
            clean_process(keep)
            work()
    except Exception as error:  # noqa: BLE001 - the report is the only channel left
        fast_json.send_document(report, {"error": "%s: %s" % (type(error).__name__, error)})
    finally:
        os._exit(0)


def spawn_command(
    argv: "list[str]", env: "dict[str, str]", workdir: "str | None", lock: int
) -> "tuple[int, int]":
    """Start ``argv`` in a session of its own with the lock inherited; returns (pid, read end of its output).

    Raises:
        OSError: the directory or the program does not exist.
    """
    folder = shell.resolve_workdir(workdir, env)
    output, output_end = os.pipe()
    error_pipe, error_pipe_end = os.pipe()
    pid = os.fork()
    if pid == 0:
        _exec_command(argv, env, folder, lock, output_end, error_pipe_end)
    os.close(output_end)
    os.close(error_pipe_end)
    with open(error_pipe, "rb") as pipe:
        reason = pipe.read()
    if reason:
        os.close(output)
        os.waitpid(pid, 0)
        raise OSError(reason.decode("utf-8", "replace"))
    return pid, output


def _exec_command(
    argv: "list[str]", env: "dict[str, str]", folder: str, lock: int, output: int, error_pipe: int
) -> "NoReturn":
    """In the child: change to ``folder`` and become ``argv``."""
    try:
        os.setsid()
        signal.set_wakeup_fd(-1)
        reset_signals()
        os.chdir(folder)
        os.dup2(output, 1)
        os.dup2(output, 2)
        os.set_inheritable(lock, True)
        os.execve(argv[0], argv, env)  # noqa: S606 - argv[0] is bash or sh
    except OSError as error:
        os.write(
            error_pipe,
            ("%s: %s" % (error.filename or argv[0], error.strerror)).encode("utf-8", "surrogateescape"),
        )
    finally:
        os._exit(127)


# In place of the wait status of a process that was no child.
UNKNOWN_EXIT = -1


def describe_exit(code: int) -> Document:
    """Describe a wait status; ``exit_code`` of a killed process is 128 + signal, as in shells."""
    if code == UNKNOWN_EXIT:
        return {"exit_code": None, "detail": "ended; exit code unknown, its first supervisor was lost"}
    if not os.WIFSIGNALED(code):
        return {"exit_code": os.WEXITSTATUS(code), "detail": "exited with %d" % os.WEXITSTATUS(code)}
    number = os.WTERMSIG(code)
    from signal import Signals

    try:
        name = Signals(number).name
    except ValueError:
        name = "signal %d" % number
    hint = " (out of memory, or by hand)" if number == signal.SIGKILL else ""
    return {"exit_code": 128 + number, "detail": "killed by %s%s" % (name, hint)}
