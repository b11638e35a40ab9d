"""How a supervisor comes to life: forked from the agent, away from the manager's session for good, in a scope of systemd where asked."""

import os
import select
import sys
import time

from . import life, light, proc, signals, spawn
from .errors import RefusalError
from .supervisor import Supervisor

_BLOCK = 65536
_REPORT_S = 10.0
# A systemd that hangs does so for 25 s and more.
_SCOPE_S, _KILL_S = 10.0, 2.0
# As the manager's own command line: whatever is run stands on standard input, which ps does not show.
_PROGRAM = "import sys;s=sys.stdin.buffer;exec(s.read(int(s.readline())))"


def launch(folder: str, lock: int, identity: dict, spec: dict, way) -> dict:
    """Start the supervisor, in a scope where ``way`` leads to one: ``{"pid": main, "limits": text}``, or ``{"error": reason}``."""
    order = {"folder": folder, "lock": lock, "identity": identity, "spec": spec}
    if way.argv:
        report, said = _in_scope(way, order)
        if report is not None:
            return report
        if spec.get("runtime") == "systemd":
            raise RefusalError(
                "no-systemd", "systemd-run did not start the task: " + said, "use runtime: auto or process"
            )
        way.why = "systemd-run failed: " + said
    read_end, report = os.pipe()
    _fork(lambda: _supervise(dict(order, report=report, why=way.why)), report, (lock, report))
    data, ended = _heard(read_end, _REPORT_S)
    os.close(read_end)
    return _report(data) or {
        "error": "the supervisor ended before the task was started" if ended else "no sign of the supervisor"
    }


def _fork(work, report: int, keep: tuple) -> None:
    """Run ``work`` in a process of a session of its own, with nothing open but ``keep``; here ``report`` is closed."""
    child = os.fork()
    if child == 0:
        _become(work, report, keep)
    os.close(report)
    os.waitpid(child, 0)


def _become(work, report: int, keep: tuple) -> None:
    """In the first child: a new session, a second fork, a clean process; never returns."""
    try:
        os.setsid()
        if os.fork() == 0:
            spawn.clean_process(keep)
            work()
    except Exception as error:  # noqa: BLE001 - there is nobody else left to tell
        spawn.tell(report, {"error": "%s: %s" % (type(error).__name__, error)})
    finally:
        os._exit(0)


def _supervise(order: dict) -> None:
    Supervisor(
        order["folder"], order["lock"], order["report"], order["identity"], order["spec"], order["why"]
    ).run()


def _heard(fd: int, patience_s: float) -> tuple:
    """(what came over the pipe, whether all ends of it are closed): the last word may take ``patience_s``."""
    data, deadline = b"", time.monotonic() + patience_s
    while select.select([fd], [], [], max(0.0, deadline - time.monotonic()))[0]:
        part = os.read(fd, _BLOCK)
        data += part
        if not part:
            return data, True
    return data, False


def _report(data: bytes):
    """The supervisor's report in what came; None where it is not there."""
    _, brace, rest = data.partition(b'{"')
    return light.loads((brace + rest).decode("ascii")) if brace else None


def apart(argv: list, env: dict, request: dict, lock: int, patience_s: float):
    """Start this very agent on ``request`` in a session of its own, behind ``argv``; its report, or None where it gives none in time."""
    read_end = _started(argv, env, request, lock)
    data, _ = _heard(read_end, patience_s)
    os.close(read_end)
    return _report(data)


def _started(argv: list, env: dict, request: dict, lock: int) -> int:
    """The end of the pipe on which the report will come. The request travels on standard input: everybody can read a command line."""
    read_end, report = os.pipe()
    source, source_end = os.pipe()
    packet = _packet(dict(request, lock=lock, report=report))
    _fork(lambda: _exec(argv, env, source, report, lock), report, (lock, report, source))
    os.close(source)
    _feed(source_end, packet)
    return read_end


def _in_scope(way, order: dict) -> tuple:
    """(report or None, complaints) by way of systemd-run.

    Raises:
        RefusalError: it did not come, and whether it may still come is not known.
    """
    request = dict(order, op="supervise", host=order["identity"]["host"], why="")
    read_end = _started(way.argv, way.env, request, order["lock"])
    data, ended = _heard(read_end, _SCOPE_S)
    if not ended:
        data, ended = data + b" no answer within %d s" % _SCOPE_S, _is_ended(data, read_end, order["folder"])
    os.close(read_end)
    if not ended:
        raise RefusalError(
            "start-failed", "systemd-run neither started the task nor can be ended", "use runtime: process"
        )
    return _report(data), " ".join(data.partition(b"\n")[2].decode("utf-8", "replace").split())[
        :300
    ] or "it said nothing"


def _is_ended(data: bytes, read_end: int, folder: str) -> bool:
    """End a systemd-run that hangs. True with proof that nothing of the task runs or ever will: pipe closed, lock held by us alone."""
    pid, ticks = [int(word) for word in data.split(b"\n")[0].split()] if b"\n" in data else (0, 0)
    signals.send(pid, ticks, signals.number("KILL"))
    return _heard(read_end, _KILL_S)[1] and not life.lock_holders(folder, proc.processes())


def _exec(argv: list, env: dict, source: int, report: int, lock: int) -> None:
    """Become ``argv`` (systemd-run), which becomes Python; who it is and its complaints go where the report is awaited."""
    os.write(report, b"%d %d\n" % (os.getpid(), proc.process(os.getpid()).ticks))
    os.dup2(source, 0)
    os.dup2(report, 2)
    for fd in (lock, report):
        os.set_inheritable(fd, True)
    argv = [*argv, sys.executable, "-I", "-S", "-c", _PROGRAM]
    os.execve(argv[0], argv, env)  # noqa: S606 - no text of the user's


def _packet(request: dict) -> bytes:
    """A request to this very agent, which the host keeps under its hash."""
    loader = sys.modules[__name__].__loader__
    boot = loader.files[os.path.join(loader.root, "edgectl_agent", "boot.py")]
    body = light.dumps(request).encode("ascii")
    head = "%032x %s %d 0 0\n" % (0, os.path.basename(loader.root), len(body))
    return b"%d\n%s%s%s" % (len(boot), boot, head.encode("ascii"), body)


def _feed(fd: int, data: bytes) -> None:
    """Write ``data`` and close; a reader that is gone or asleep will send no report, which says enough."""
    deadline = time.monotonic() + _SCOPE_S
    os.set_blocking(fd, False)
    try:
        while data and select.select([], [fd], [], max(0.0, deadline - time.monotonic()))[1]:
            data = data[os.write(fd, data) :]
    except OSError:
        pass
    os.close(fd)


def supervise(request: dict) -> None:
    """Operation ``supervise``: what ``_in_scope`` asks of the process in the scope; never returns."""
    lock, report = int(request["lock"]), int(request["report"])
    try:
        spawn.clean_process((lock, report))
        for fd in (lock, report):
            os.set_inheritable(fd, False)
        if _is_awaited(report):
            _supervise(request)
    except Exception as error:  # noqa: BLE001 - there is nobody else left to tell
        spawn.tell(report, {"error": "%s: %s" % (type(error).__name__, error)})
    finally:
        os._exit(0)


def _is_awaited(report: int) -> bool:
    """False where the agent has given up: whoever asked was told that nothing was started."""
    poll = select.poll()
    poll.register(report, select.POLLOUT)
    return not any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
