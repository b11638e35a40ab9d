"""From a clean process to a running command: what the supervisor and its task do with signals, descriptors and sessions."""

import ctypes
import os
import signal

from . import light

_PR_SET_NAME, _PR_SET_CHILD_SUBREAPER = 15, 36
_MOST_FDS = 1 << 16


def clean_process(keep: tuple) -> None:
    """Make this process a daemon's: default signals, umask 077, directory /, no descriptors but ``keep``, subreaper of its tree."""
    reset_signals()
    os.umask(0o077)
    os.chdir("/")
    null = os.open(os.devnull, os.O_RDWR)
    for fd in (0, 1, 2):
        os.dup2(null, fd)
    close_all_but({0, 1, 2} | set(keep))
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_NAME, b"edgectl-task", 0, 0, 0)
    if libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "this kernel has no child subreaper")


def reset_signals() -> None:
    """Every disposition to its default, nothing blocked: a login by SSH or nohup may have left INT ignored."""
    for number in range(1, signal.NSIG):
        try:
            signal.signal(number, signal.SIG_DFL)
        except (OSError, ValueError):
            continue
    signal.pthread_sigmask(signal.SIG_SETMASK, set())


def close_all_but(keep: set) -> None:
    """Close every other descriptor."""
    try:
        fds = [int(name) for name in os.listdir("/proc/self/fd")]
    except OSError:
        fds = list(range(min(_MOST_FDS, os.sysconf("SC_OPEN_MAX"))))
    for fd in fds:
        if fd not in keep:
            try:
                os.close(fd)
            except OSError:
                continue


def tell(fd: int, document: dict) -> None:
    """Send the one report to the agent and let go of the pipe."""
    try:
        os.write(fd, light.dumps(document).encode("ascii"))
        os.close(fd)
    except OSError:
        pass


def working_dir(wish, env: dict) -> str:
    """Where the command runs: as asked, else the home directory, else /."""
    home = env.get("HOME") or "/"
    return os.path.expanduser(str(wish)) if wish else home if os.path.isdir(home) else "/"


def spawn(argv: list, env: dict, workdir, lock: int) -> tuple:
    """Start ``argv`` in a session of its own with the lock inherited; returns (pid, read end of its output).

    Raises:
        OSError: the directory or the program is not there.
    """
    folder = working_dir(workdir, env)
    output, output_end = os.pipe()
    trouble, trouble_end = os.pipe()
    pid = os.fork()
    if pid == 0:
        _exec(argv, env, folder, lock, output_end, trouble_end)
    os.close(output_end)
    os.close(trouble_end)
    with open(trouble, "rb") as pipe:
        reason = pipe.read()
    if reason:
        os.close(output)
        os.waitpid(pid, 0)
        raise OSError(reason.decode("utf-8", "replace"))
    return pid, output


def _exec(argv: list, env: dict, folder: str, lock: int, output: int, trouble: int) -> None:
    """In the child: never returns."""
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
            trouble,
            ("%s: %s" % (error.filename or argv[0], error.strerror)).encode("utf-8", "surrogateescape"),
        )
    finally:
        os._exit(127)


def outcome(code: int) -> dict:
    """A wait status in words; ``exit_code`` of a killed process is 128 + signal, as shells have it."""
    if not os.WIFSIGNALED(code):
        return {"exit_code": os.WEXITSTATUS(code), "detail": "exited with %d" % os.WEXITSTATUS(code)}
    number = os.WTERMSIG(code)
    try:
        name = signal.Signals(number).name
    except ValueError:
        name = "signal %d" % number
    hint = " (out of memory, or by hand)" if number == signal.SIGKILL else ""
    return {"exit_code": 128 + number, "detail": "killed by %s%s" % (name, hint)}
