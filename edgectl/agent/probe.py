"""Operation ``probe``: what the three profilers say of this host, in one document."""

import os
import sys
import time

from . import device, metrics, network, proc, state, status
from .task import TaskMeter

_LONGEST_WINDOW_S = 30.0
_SHORTEST_KNOCK_S = 0.02


def probe(request: dict) -> dict:
    """Measure this host, its links and its tasks, and run the ``done_when`` checks of the tasks that are alive.

    Where a profiler lives (``resident``) its last sample is taken; else a sample window passes, and the checks run meanwhile.
    """
    measured, checks = _from_profiler(request) or _over_window(request)
    for task, values in metrics.of_tasks(request["host"], measured["tasks"]).items():
        measured["tasks"][task]["metrics"] = values
    return dict(
        {
            "v": 1,
            "op": "probe",
            "host": request["host"],
            "python": "%d.%d.%d" % sys.version_info[:3],
            "boot_id": proc.boot_id(),
            "wall": time.time(),
            "load_1m": device.load_1m(),
            "generations": _generations(request["host"], measured["tasks"]),
            "checks": checks.results(),
        },
        **measured,
    )


def _from_profiler(request: dict):
    """(measured part of the reply, checks under way), or None: no profiler, none that measures what is asked, or one that is late."""
    if not any(
        os.path.isdir(os.path.join(levels[-1], "profiler")) for levels in state.host_places(request["host"])
    ):
        return None
    from .latest import ALIVE, latest

    found = latest(request)
    return found and (
        found,
        _Checks(
            request.get("checks", []), {name: each["state"] in ALIVE for name, each in found["tasks"].items()}
        ),
    )


def _over_window(request: dict) -> tuple:
    """(measured part of the reply, checks under way)."""
    window = min(_LONGEST_WINDOW_S, max(0.05, float(request.get("window_s", 0.5))))
    addresses = network.resolve(request.get("links", []))
    tasks = TaskMeter(request["host"], request.get("detect", []))
    checks = _Checks(request.get("checks", []), tasks.before)
    traffic, totals = network.Traffic(addresses), network.interface_bytes()
    cpu, started = device.CpuMeter(), time.monotonic()
    # Its import costs more than all else here; within the window it delays nothing.
    psutil = device.find_psutil()
    knocks = network.Knocks(addresses)
    knocks.wait(max(started + window, time.monotonic() + _SHORTEST_KNOCK_S))
    reading = cpu.reading()
    seconds = time.monotonic() - started
    flows, rates = traffic.flows(), network.rates(totals, network.interface_bytes(), seconds)
    traffic.close()
    measured = tasks.reading(flows, addresses, seconds)
    knocks.close(addresses)
    return {
        "psutil": psutil is not None,
        "window_s": round(seconds, 4),
        "cpu": reading,
        "memory": device.memory(psutil),
        "temperature_c": device.temperature_c(psutil),
        "gpu_share": device.gpu_share(),
        "interfaces": {name: network.interface(rate, network.speed(name)) for name, rate in rates.items()},
        "links": network.links(addresses, flows, knocks, seconds, network.ways(addresses)),
        "tasks": measured,
    }, checks


def _generations(host: str, measured: dict) -> dict:
    """Task -> highest generation seen here, where the task's own entry does not tell: without it a manager cannot start the task again."""
    seen = {name: status.seen_generation(host, name) for name in state.task_names(host)}
    return {
        name: number for name, number in seen.items() if number > measured.get(name, {}).get("generation", 0)
    }


class _Checks:
    """The checks that are due, running beside the sample window."""

    def __init__(self, wishes: list, alive: dict) -> None:
        due = [wish for wish in wishes if wish.get("always") or alive.get(str(wish["task"]))]
        self._commands = {}
        if not due:
            return
        from . import shell

        shell.guard()
        self._commands = {
            str(wish["task"]): shell.Command(
                wish["command"], wish.get("prelude", ""), wish.get("env"), float(wish.get("timeout_s", 10.0))
            )
            for wish in due
        }

    def results(self) -> dict:
        """Task -> result, waiting for the slow ones up to their own timeouts."""
        return {task: command.result() for task, command in self._commands.items()}
