# SPDX-License-Identifier: Apache-2.0
"""Operation ``probe``: host, links and tasks of this host in one document."""

import os
import sys
import time

from ..link import protocol
from ..link.boot import is_dir
from ..link.fast_json import Document
from ..supervise import grants, other_tasks, state_dir, unowned
from . import device, interfaces, system_files
from .task_meter import TaskMeter, Traffic

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Mapping

    from ..supervise.spec_check import RunningCheck
    from .link_meter import LinkMeter
    from .network import ConnectProbes

_MAX_WINDOW_S = 30.0
_MIN_CONNECT_S = 0.02
# What the polynomial of zlib.crc32 makes of each four bits.
_CRC_OF_HALF_BYTES = (
    *(0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4, 0x4DB26158, 0x5005713C),
    *(0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C, 0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C),
)


def probe_host(request: Document) -> Document:
    """Measure this host, its links and its tasks, and run the ``done_when`` checks of the tasks that are
    alive.

    Where a resident profiler runs, its last sample is used; otherwise a sample window passes, with the checks
    running meanwhile.
    """
    return probe_again(request, None)


def probe_again(request: Document, meter: "WindowMeter | None") -> Document:
    """Probe as ``probe_host``; with the meter of a probe before, over the time since then."""
    lease = _claim_lease(request)
    measured, checks = _read_profiler(request) or (
        _measure_window(request) if meter is None else meter.measure()
    )
    sample_at = measured.pop("sample_at", 0.0)
    if meter is not None:
        meter.sample_at = sample_at
    if measured["tasks"]:
        _add_metrics(request["host"], measured["tasks"])
    # After the measurement, in which it would count, and for none who only reads.
    if lease and lease["lease"]["state"] == "granted":
        _remove_dead_containers(request["host"])
    return dict(
        {
            "v": protocol.VERSION,
            "op": protocol.OP_PROBE,
            "host": request["host"],
            "python": "%d.%d.%d" % sys.version_info[:3],
            "boot_id": system_files.read_boot_id(),
            "pid_namespace": system_files.read_pid_namespace(),
            "machine": _describe_place(),
            "wall": time.time(),
            "load_1m": device.read_load_1m(),
            "grants": grants.read_grants(request.get("manager", "")),
            "generations": _list_generations(
                [request["host"], *request.get("former", [])], measured["tasks"]
            ),
            "other_tasks": other_tasks.list_other_tasks(request["host"]),
            "unowned": unowned.list_unowned_tasks(request["host"]),
            "former": state_dir.list_host_names(request["host"])[1:],
            "checks": checks.results(),
            "latencies": _read_latencies(request, measured["tasks"]),
        },
        **measured,
        **lease,
        **_read_totals(request),
        **_list_engines(request),
    )


def _add_metrics(host: str, tasks: "dict[str, Document]") -> None:
    from .metrics import read_tasks_metrics

    for task, values in read_tasks_metrics(host, tasks).items():
        tasks[task]["metrics"] = values


def _read_latencies(request: Document, tasks: "dict[str, Document]") -> "dict[str, Document]":
    if not request.get("latency"):
        return {}
    from .latency_reply import read_latencies

    return read_latencies(request["host"], request["latency"], tasks)


def _read_totals(request: Document) -> Document:
    if not request.get("totals"):
        return {}
    from .totals import read_totals

    return {"totals": read_totals(request["host"])}


def _list_engines(request: Document) -> Document:
    """The container engines that this user may use, where a task of the fleet has an image."""
    if not request.get("engines"):
        return {}
    from ..containers.engine import list_usable_engines

    return {"engines": list_usable_engines(swarm=bool(request.get("swarm")))}


def _describe_place() -> str:
    """Describe where the tasks of this login are: machine, user and state directories."""
    folders = _compute_crc32("\0".join(state_dir.BASES).encode("utf-8", "surrogateescape"))
    return "%s/%d/%08x" % (system_files.read_machine_id(), os.getuid(), folders)


def _compute_crc32(data: bytes) -> int:
    """Compute zlib.crc32, which many builds of Python have in a library that takes 0.4 ms to load."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        crc = crc >> 4 ^ _CRC_OF_HALF_BYTES[crc & 15]
        crc = crc >> 4 ^ _CRC_OF_HALF_BYTES[crc & 15]
    return crc ^ 0xFFFFFFFF


def _claim_lease(request: Document) -> Document:
    """Claim the fleet before anything is measured: what is seen then, no other manager changes afterwards."""
    if "lease" not in request:
        return {}
    from ..supervise.lease import claim_lease

    return {"lease": claim_lease(request["lease"])}


def _remove_dead_containers(host: str) -> None:
    """Begin to remove what engines may still have of tasks of this host that have ended, as after a loss of
    power.
    """
    from ..supervise import task_dirs

    folders = task_dirs.find_task_dirs_with(host, "container")
    if not folders:
        return
    from ..containers.record import may_be_left
    from ..supervise import lockfile

    ended = [each for each in folders if may_be_left(each) and not lockfile.is_lock_held(each)]
    if ended:
        from ..containers.removal import begin_removal

        begin_removal(ended)


def _read_profiler(request: Document) -> "tuple[Document, _RunningChecks] | None":
    """Read (measured part of the reply, running checks).

    None without a profiler that measures what is asked and is on time.
    """
    hosts = [state_dir.find_host_dir(base, request["host"]) for base in state_dir.BASES]
    if not any(is_dir(host + "/profiler") for host in hosts):
        return None
    from ..daemon.reader import read_measurements

    found = read_measurements(request)
    if found is None:
        return None
    return (
        found,
        _RunningChecks(
            request["host"],
            request.get("checks", []),
            {name: each["state"] in protocol.ALIVE_STATES for name, each in found["tasks"].items()},
        ),
    )


def _measure_window(request: Document) -> "tuple[Document, _RunningChecks]":
    """Measure over a window: (measured part of the reply, running checks)."""
    meter = WindowMeter(request)
    try:
        return meter.measure()
    finally:
        meter.close()


class WindowMeter:
    """Meter of this host: of a window, and with each further call since the one before.

    ``sample_at``: of the profiler's sample that the last probe used instead (s since boot); 0 for none.
    """

    def __init__(self, request: Document, links: "LinkMeter | None" = None) -> None:
        """``links``: not begun yet; without it there is one where the request has links, or a task lives."""
        self._request, self._links = request, links
        self._window = min(_MAX_WINDOW_S, max(0.05, float(request.get("window_s", 0.5))))
        self._began = self.sample_at = 0.0

    def measure(self) -> "tuple[Document, _RunningChecks]":
        """Let a window pass and measure: (measured part of the reply, running checks)."""
        due = time.monotonic() + self._window
        if not self._began:
            self._begin()
            due = self._began + self._window
        checks = _RunningChecks(self._tasks.host, self._request.get("checks", []), self._tasks.before)
        if self._links is None:
            time.sleep(max(0.0, due - time.monotonic()))
            return self._read(None), checks
        probes = self._links.start_probes()
        probes.wait(max(due, time.monotonic() + _MIN_CONNECT_S))
        return self._read(probes), checks

    def close(self) -> None:
        """Listen no longer for connections that are closed."""
        if self._began and self._links is not None:
            self._links.close()

    def _begin(self) -> None:
        request = self._request
        if request.get("links") or request.get("peers"):
            # Before the tasks: names may take seconds.
            self._links = self._links or _make_link_meter(request)
        self._tasks = TaskMeter(request["host"], request.get("detect", []))
        if self._tasks.may_live:
            self._links = self._links or _make_link_meter(request)
        if self._links is not None:
            self._links.begin()
        self._totals = interfaces.read_interface_bytes()
        self._radios = interfaces.start_radio_meter()
        self._hardware = device.start_hardware_meter()
        self._cpu, self._began = device.CpuMeter(), time.monotonic()

    def _read(self, probes: "ConnectProbes | None") -> Document:
        cpu = self._cpu.measure()
        since, self._began = self._began, time.monotonic()
        seconds, then = self._began - since, self._totals
        self._totals = interfaces.read_interface_bytes()
        rates = interfaces.compute_rates(then, self._totals, seconds)
        if self._links is None or probes is None:
            tasks = self._tasks.measure(Traffic([], {}, {}), seconds)
            measured: Document = {"links": {}, "counters": "", "peers": {}, "tasks": tasks}
        else:
            measured = self._links.measure(probes, self._tasks, seconds)
        wireless = {} if self._radios is None else self._radios.measure()
        return {
            "psutil": device.find_psutil_folder() is not None,
            "window_s": round(seconds, 4),
            "cpu": cpu,
            "memory": device.read_memory(),
            "temperature_c": device.read_temperature_c(),
            **device.measure_hardware(self._hardware),
            "interfaces": {
                name: interfaces.build_interface_entry(
                    rate, interfaces.read_interface_speed(name), wireless.get(name)
                )
                for name, rate in rates.items()
            },
            **measured,
        }


def _make_link_meter(request: Document) -> "LinkMeter":
    from .link_meter import LinkMeter

    return LinkMeter(request)


def _list_generations(hosts: "list[str]", measured: "dict[str, Document]") -> "dict[str, int]":
    """List task -> highest generation seen here under these host names where the task's entry has a lower one
    or none: a manager needs it to start the task, and to know these directories again.
    """
    seen: "dict[str, int]" = {}
    for host in hosts:
        for name in state_dir.list_task_names(host):
            from ..supervise import status

            seen[name] = max(seen.get(name, 0), status.read_generation(host, name))
    return {
        name: number for name, number in seen.items() if number > measured.get(name, {}).get("generation", 0)
    }


class _RunningChecks:
    """The checks that are due, running beside the sample window."""

    def __init__(self, host: str, rules: "list[Document]", alive: "Mapping[str, object]") -> None:
        """``alive``: tasks that live, by truth value; checks of others run only with ``always``."""
        due = [rule for rule in rules if rule.get("always") or alive.get(str(rule["task"]))]
        self._running: "dict[str, RunningCheck]" = {}
        if not due:
            return
        from ..ros.question import start_rules

        self._running = start_rules(due, host)

    def results(self) -> "dict[str, Document]":
        """Wait for the checks, each up to its own timeout: task -> result."""
        return {task: check.result() for task, check in self._running.items()}
