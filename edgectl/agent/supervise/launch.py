# SPDX-License-Identifier: Apache-2.0
"""Launch of a supervisor or profiler from the agent: a session of its own, inside a systemd scope where
requested.
"""

import os
import select
import sys
import time
import zlib

from ..link import fast_json, protocol
from ..link.errors import RefusalError
from ..link.fast_json import Document
from ..measure import proc
from . import lockfile, signals, spawn
from .liveness import InstanceRecord
from .scope import Scope
from .supervisor import Supervisor

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any, NoReturn

_BLOCK = 65536
_REPORT_S = 10.0
# A systemd that hangs does so for 25 s and more.
_SCOPE_S, _KILL_S = 10.0, 2.0
# What systemd-run says of a scope that it has started.
_RUNNING = "Running "
# As the manager's own command line: the program comes on standard input, which ps does not show.
_PROGRAM = "import sys;s=sys.stdin.buffer;exec(s.read(int(s.readline())))"


def launch_supervisor(
    folder: str, lock: int, identity: Document, spec: Document, task_scope: Scope
) -> Document:
    """Start the supervisor, in a scope where ``task_scope`` has one: ``{"pid": main, "limits": text}``, or
    ``{"error": reason}``.
    """
    order: Document = {"folder": folder, "lock": lock, "identity": identity, "spec": spec}
    if task_scope.argv:
        report, complaints = _launch_in_scope(task_scope, order)
        if report is not None:
            return report
        if spec.get("runtime") == "systemd":
            raise RefusalError(
                "no-systemd",
                "systemd-run did not start the task: " + complaints,
                "use runtime: auto or process",
            )
        task_scope.why = "systemd-run failed: " + complaints
    read_end, write_end = os.pipe()
    order.update(report=write_end, why=task_scope.why)
    spawn.run_detached(lambda: _run_ordered_supervisor(order), write_end, (lock, write_end))
    data, ended = _read_pipe(read_end, _get_report_s(spec))
    os.close(read_end)
    return _parse_report(data) or {
        "error": "the supervisor exited before the task was started"
        if ended
        else "no report from the supervisor"
    }


def _get_report_s(spec: Document) -> float:
    if not spec.get("image"):
        return _REPORT_S
    from ..containers.command import REPORT_S

    return REPORT_S + _REPORT_S


def launch_takeover(record: InstanceRecord, lock: int, guard: int, spec: Document) -> Document:
    """Start a supervisor on the living tree of ``record``: its report, or ``{"error": reason}``.

    ``lock`` is -1 where the tree holds it; ``guard`` is held for as long as the supervisor lives.
    """
    read_end, write_end = os.pipe()
    kept = tuple(fd for fd in (lock, guard, write_end) if fd >= 0)

    def supervise() -> None:
        Supervisor(record.folder, lock, write_end, record.instance, spec, "", orphan=record.status).run()

    spawn.run_detached(supervise, write_end, kept)
    data, _ = _read_pipe(read_end, _REPORT_S)
    os.close(read_end)
    return _parse_report(data) or {"error": "no report from the supervisor"}


def _run_ordered_supervisor(order: Document) -> None:
    Supervisor(
        order["folder"], order["lock"], order["report"], order["identity"], order["spec"], order["why"]
    ).run()


def _read_pipe(fd: int, patience_s: float) -> "tuple[bytes, bool]":
    """Read (data, whether all writers have closed the pipe) for at most ``patience_s``."""
    data, deadline = b"", time.monotonic() + patience_s
    while select.select([fd], [], [], max(0.0, deadline - time.monotonic()))[0]:
        part = os.read(fd, _BLOCK)
        data += part
        if not part:
            return data, True
    return data, False


def _parse_report(data: bytes) -> "Document | None":
    """Parse the supervisor's report in the data read; None where it is missing."""
    _, brace, rest = data.partition(b'{"')
    return fast_json.loads((brace + rest).decode("ascii")) if brace else None


def launch_agent(
    argv: "list[str]", env: "dict[str, str]", request: Document, lock: int, patience_s: float
) -> "Document | None":
    """Start this agent on ``request`` in a session of its own, behind ``argv``.

    Its report, or None where none comes in time.
    """
    read_end = _start_agent(argv, env, request, lock)
    data, _ = _read_pipe(read_end, patience_s)
    os.close(read_end)
    return _parse_report(data)


def _start_agent(argv: "list[str]", env: "dict[str, str]", request: Document, lock: int) -> int:
    """Start the agent; returns the read end of its report.

    The request travels on standard input: command lines are public.
    """
    read_end, report = os.pipe()
    source, source_end = os.pipe()
    packet = _build_packet(dict(request, lock=lock, report=report))
    spawn.run_detached(lambda: _exec_agent(argv, env, source, report, lock), report, (lock, report, source))
    os.close(source)
    _feed_pipe(source_end, packet)
    return read_end


def _launch_in_scope(task_scope: Scope, order: Document) -> "tuple[Document | None, str]":
    """Launch through systemd-run: (report or None, its error output).

    Raises:
        RefusalError: no report came, and it is unknown whether it may still come.
    """
    identity = order["identity"]
    request = dict(order, op=protocol.OP_SUPERVISE, fleet=identity["fleet"], host=identity["host"], why="")
    read_end = _start_agent(task_scope.argv, task_scope.env, request, order["lock"])
    data, ended = _read_pipe(read_end, _SCOPE_S)
    report, in_time = _parse_report(data), ended
    if report is None and not ended:
        more, ended = _end_systemd_run(data, read_end)
        data += more
    os.close(read_end)
    if report is not None:
        return report, ""
    if not ended:
        raise RefusalError(
            "start-failed", "systemd-run did not start the task and cannot be killed", "use runtime: process"
        )
    if lockfile.find_lock_holders(order["folder"], proc.read_process_table()):
        raise RefusalError(
            "start-failed",
            "the supervisor ended as it started the task, and left processes",
            "edgectl stop ends them",
        )
    return None, describe_silence(data, in_time=in_time)


def _end_systemd_run(data: bytes, read_end: int) -> "tuple[bytes, bool]":
    """Kill a systemd-run that hangs: what it says still, and whether all that could report is gone."""
    pid, ticks = [int(word) for word in data.split(b"\n")[0].split()] if b"\n" in data else (0, 0)
    signals.send_signal(pid, ticks, signals.parse_signal("KILL"))
    return _read_pipe(read_end, _KILL_S)


def describe_silence(data: bytes, *, in_time: bool) -> str:
    """Describe the end of a systemd-run that no report followed. ``data``: its identity, and what it said;
    ``in_time``: it ended by itself.
    """
    lines = data.decode("utf-8", "replace").splitlines()[1:]
    said = " ".join(" ".join(line for line in lines if not line.startswith(_RUNNING)).split())[:300]
    if not in_time:
        return (said + "; " if said else "") + "no answer within %d s" % _SCOPE_S
    begun = any(line.startswith(_RUNNING) for line in lines)
    return said or ("the supervisor ended in its scope" if begun else "it ended without a word")


def _exec_agent(argv: "list[str]", env: "dict[str, str]", source: int, report: int, lock: int) -> None:
    """Become ``argv`` (systemd-run), which becomes Python.

    Its identity and its error output are written to ``report``.
    """
    os.write(report, b"%d %d\n" % (os.getpid(), proc.read_own_process().ticks))
    os.dup2(source, 0)
    os.dup2(report, 2)
    for fd in (lock, report):
        os.set_inheritable(fd, True)
    argv = [*argv, sys.executable, "-I", "-S", "-c", _PROGRAM]
    os.execve(argv[0], argv, env)  # noqa: S606 - contains no text of the user


def _build_packet(request: Document) -> bytes:
    """Build a request to this very agent, which the host caches under its hash."""
    loader: "Any" = sys.modules[__name__].__loader__
    sources = loader.read_sources()
    first, *others = (sources["edgectl_agent/link/" + name] for name in ("first.py", "stub.py", "boot.py"))
    programs = b"".join(b"%d\n%s" % (len(text), text) for text in (first, zlib.compress(b"\0".join(others))))
    body = fast_json.dumps(request).encode("ascii")
    head = "%032x %s %d 0 0 %s %s\n" % (0, loader.sha, len(body), loader.key, request["op"])
    return programs + head.encode("ascii") + body


def _feed_pipe(fd: int, data: bytes) -> None:
    """Write ``data`` and close; a reader that is gone or hangs sends no report, which is detected there."""
    deadline = time.monotonic() + _SCOPE_S
    os.set_blocking(fd, False)
    try:
        while data and select.select([], [fd], [], max(0.0, deadline - time.monotonic()))[1]:
            data = data[os.write(fd, data) :]
    except OSError:
        pass
    os.close(fd)


def run_supervisor(request: Document) -> "NoReturn":
    """Operation ``supervise``: the request of ``_launch_in_scope`` to the process in the scope."""
    lock, report = int(request["lock"]), int(request["report"])
    try:
        spawn.clean_process((lock, report))
        for fd in (lock, report):
            os.set_inheritable(fd, False)
        if _is_report_awaited(report):
            _run_ordered_supervisor(request)
    except Exception as error:  # noqa: BLE001 - the report is the only channel left
        fast_json.send_document(report, {"error": "%s: %s" % (type(error).__name__, error)})
    finally:
        os._exit(0)


def _is_report_awaited(report: int) -> bool:
    """False where the agent has given up and has already replied that nothing was started."""
    poll = select.poll()
    poll.register(report, select.POLLOUT)
    return not any(event & (select.POLLERR | select.POLLHUP) for _, event in poll.poll(0))
