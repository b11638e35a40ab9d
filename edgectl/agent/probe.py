"""Operation ``probe``: the three profilers over one sample window, in one document."""

import sys
import time

from . import device, network, proc, state, status
from .task import TaskMeter

_LONGEST_WINDOW_S = 30.0
_SHORTEST_KNOCK_S = 0.02


def probe(request: dict) -> dict:
    """Measure this host, its links and its tasks; run the ``done_when`` checks of the tasks that are alive meanwhile."""
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
    flows, totals_after = traffic.flows(), network.interface_bytes()
    measured = tasks.reading(flows, addresses, seconds)
    knocks.close(addresses)
    return {
        "v": 1,
        "op": "probe",
        "host": request["host"],
        "python": "%d.%d.%d" % sys.version_info[:3],
        "psutil": psutil is not None,
        "boot_id": proc.boot_id(),
        "wall": time.time(),
        "window_s": round(seconds, 4),
        "cpu": reading,
        "memory": device.memory(psutil),
        "load_1m": device.load_1m(),
        "temperature_c": device.temperature_c(psutil),
        "gpu_share": device.gpu_share(),
        "interfaces": network.interfaces(totals, totals_after, seconds),
        "links": network.links(addresses, flows, knocks, seconds),
        "tasks": measured,
        "generations": _generations(request["host"], measured),
        "checks": checks.results(),
    }


def _generations(host: str, measured: dict) -> dict:
    """Task -> highest generation seen here, where the task's own entry does not tell: without it a manager cannot start the task again."""
    seen = {name: status.seen_generation(host, name) for name in state.task_names(host)}
    return {name: number for name, number in seen.items() if number > measured.get(name, {}).get("generation", 0)}


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
            str(wish["task"]): shell.Command(wish["command"], wish.get("prelude", ""), wish.get("env"), float(wish.get("timeout_s", 10.0)))
            for wish in due
        }

    def results(self) -> dict:
        """Task -> result, waiting for the slow ones up to their own timeouts."""
        return {task: command.result() for task, command in self._commands.items()}
