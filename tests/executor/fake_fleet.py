# SPDX-License-Identifier: Apache-2.0
"""Simulated hosts behind FakeTransport: they implement the agent protocol and record what ran where."""

import copy
import threading
import time
from collections import UserDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

from edgectl.errors import ConnectError, HostError, RefusedError
from edgectl.transport.fake import FakeTransport, Handler

Request = dict[str, object]


@dataclass
class SharedEvents:
    """State shared by all hosts: the order of events, and the greatest number of instances of a task at a
    time.
    """

    events: list[str] = field(default_factory=list)
    alive: dict[str, set[str]] = field(default_factory=dict)
    overlap: set[str] = field(default_factory=set)
    guard: threading.Lock = field(default_factory=threading.Lock)

    def note(self, event: str) -> None:
        with self.guard:
            self.events.append(event)

    def begins(self, task: str, host: str) -> None:
        with self.guard:
            places = self.alive.setdefault(task, set())
            places.add(host)
            if len(places) > 1:
                self.overlap.add(task)

    def ends(self, task: str, host: str) -> None:
        with self.guard:
            self.alive.setdefault(task, set()).discard(host)


@dataclass
class FakeHost:
    """One host. ``faults`` maps an operation (``start``, ``stop:slam``) to an error to raise or a function
    that returns the reply. ``others``: living tasks of its machine that are not this host's;
    ``former``: the names of these that it has adopted, as the fleet "unnamed".
    """

    name: str
    world: SharedEvents
    cores: float = 4.0
    used: float = 0.0
    tasks: dict[str, Request] = field(default_factory=dict)
    faults: dict[str, HostError | Callable[[Request], Request]] = field(default_factory=dict)
    delay: float = 0.0
    checks: dict[str, int] = field(default_factory=dict)
    seen: dict[str, int] = field(default_factory=dict)
    others: list[Request] = field(default_factory=list)
    former: list[str] = field(default_factory=list)

    def __call__(self, request: Request) -> Request:
        assert request["host"] == self.name
        op, task = str(request["op"]), str(request.get("task"))
        for key in (f"{op}:{task}", op):
            fault = self.faults.get(key)
            if isinstance(fault, HostError):
                raise type(fault)(fault.message, hint=fault.hint)
            if fault is not None:
                return fault(request)
        reply: dict[str, object] = getattr(self, f"_{op}")(request)
        return reply

    def _fence(self, request: Request) -> None:
        """Reject a generation older than the newest one."""
        name, generation = str(request["task"]), request["generation"]
        assert isinstance(generation, int)
        if generation < self.seen.get(name, 0):
            raise RefusedError(
                f"generation {generation} of {name} is older than {self.seen[name]}, the highest seen by this host"
            )
        self.seen[name] = generation

    def _start(self, request: Request) -> Request:
        name = str(request["task"])
        self._fence(request)
        running = self.tasks.get(name)
        if running and (running["instance"] == request["instance"] or running.get("role")):
            return {**running, "state": "already-running"}
        if running and running["pid"]:
            raise RefusedError(f"{name} runs already")
        spec = request["spec"]
        assert isinstance(spec, dict)
        role = str(request["role"]) if spec["activation"] else ""
        self.world.note(f"start {name} {self.name}" if role != "standby" else f"copy {name} {self.name}")
        if role != "standby":
            self.world.begins(name, self.name)
        state = "running" if spec["ready"] is None and role != "standby" else "starting"
        entry = {
            "state": state,
            "pid": 100,
            "instance": request["instance"],
            "generation": request["generation"],
            "spec_hash": spec["spec_hash"],
            "role": role,
            "switching": False,
        }
        self.tasks[name] = entry
        return {**entry, "state": "started"}

    def _activate(self, request: Request) -> Request:
        return self._switch(request, "active")

    def _deactivate(self, request: Request) -> Request:
        return self._switch(request, "standby")

    def _switch(self, request: Request, role: str) -> Request:
        name = str(request["task"])
        self._fence(request)
        running = self.tasks.get(name)
        if running is None or running["instance"] != request["instance"]:
            raise RefusedError(f"{name} is not running here")
        self.world.note(f"{request['op']} {name} {self.name}")
        self.world.begins(name, self.name) if role == "active" else self.world.ends(name, self.name)
        running |= {"role": role, "generation": request["generation"]}
        return {"state": role, "role": role, "switching": False, "instance": running["instance"]}

    def _adopt(self, request: Request) -> Request:
        self.former = list(request["former"])  # type: ignore[call-overload]
        for each in self.others:
            if each["host"] in self.former and each["fleet"] == request["fleet"]:
                self.runs(str(each["task"]), instance=str(each["instance"]))
        return {"adopted": []}

    def _takeover(self, request: Request) -> Request:
        name = str(request["task"])
        self._fence(request)
        self.world.note(f"adopt {name} {self.name}")
        self.tasks[name] |= {"orphaned": False, "adoptable": False, "detail": "adopted"}
        return {"state": "taken-over", "instance": request["instance"]}

    def _wait(self, request: Request) -> Request:
        name = str(request["task"])
        time.sleep(self.delay)
        if name not in self.tasks:
            return {"state": "failed", "exit_code": 1}
        if self.tasks[name]["state"] == "starting":
            self.tasks[name]["state"] = "ready"
        self.world.note(f"ready {name} {self.name}")
        return self.tasks[name]

    def _mark(self, request: Request) -> Request:
        self.world.note(f"mark {request['task']} {self.name}")
        self.tasks[str(request["task"])]["state"] = "ready"
        return {"state": "ready"}

    def _stop(self, request: Request) -> Request:
        name = str(request["task"])
        time.sleep(self.delay)
        self._fence(request)
        self.world.note(f"stop {name} {self.name}")
        self.world.ends(name, self.name)
        return {
            "state": "stopped" if self.tasks.pop(name, None) else "not-running",
            "left": [],
            "seconds": 0.0,
        }

    def _status(self, request: Request) -> Request:
        return {
            "tasks": {name: entry for name, entry in self.tasks.items() if request["task"] in (None, name)}
        }

    def _check(self, request: Request) -> Request:
        command = str(request["command"])
        self.world.note(f"check {command} {self.name}")
        return {"exit": self.checks.get(command, 0), "timed_out": False, "output": f"said by {command}"}

    def _logs(self, request: Request) -> Request:
        return {"text": f"{request['tail']} lines of {request['task']}\n"}

    def _follow(self, request: Request) -> Request:
        return self._logs(request)

    def _lease(self, request: Request) -> Request:
        return {"state": {"renew": "renewed", "release": "released"}[str(request["action"])]}

    def _probe(self, request: Request) -> Request:
        links = [entry["robot"] for entry in request["links"]]  # type: ignore[attr-defined]
        entries = {
            name: {
                "age_s": 3600.0,
                "used_cores": 0.1,
                "used_bytes": 1e6,
                "rx_bytes_per_s": 0.0,
                "tx_bytes_per_s": 0.0,
                "links": {},
                **entry,
            }
            for name, entry in self.tasks.items()
        }
        return {
            "v": 1,
            "op": "probe",
            "host": self.name,
            "python": "3.11.2",
            "boot_id": "boot",
            "wall": 0.0,
            "cpu": {"cores": self.cores, "used_cores": self.used},
            "memory": {"total_bytes": 4 * 2**30, "used_bytes": 0},
            "links": {
                robot: {"rx_bytes_per_s": 0.0, "tx_bytes_per_s": 0.0, "rtt_ms": 1.0} for robot in links
            },
            "tasks": entries,
            "generations": dict(self.seen),
            "other_tasks": [each for each in self.others if each["host"] not in self.former],
            "former": list(self.former),
            "checks": {},
            **({"lease": {"state": "granted", "epoch": 1}} if "lease" in request else {}),
        }

    def waits(self, name: str, *, instance: str = "copy") -> None:
        """Put an inactive copy of a task on the host as if it had been started before."""
        self.runs(name, instance=instance, role="standby")

    def runs(
        self,
        name: str,
        *,
        spec_hash: str = "",
        instance: str = "old",
        state: str = "running",
        role: str = "",
    ) -> None:
        """Put a task on the host as if it had been started before."""
        self.tasks[name] = {
            "state": state,
            "pid": 99,
            "instance": instance,
            "generation": 1,
            "spec_hash": spec_hash or f"hash-{name}",
            "role": role,
            "switching": False,
        }
        if role != "standby":
            self.world.begins(name, self.name)


class _Reachable(UserDict[str, Handler | HostError]):
    """The handlers of the hosts that are on at the time of the request."""

    def __init__(self, handlers: Mapping[str, Handler | HostError], down: set[str]) -> None:
        super().__init__(handlers)
        self._down = down

    def __getitem__(self, name: str) -> Handler | HostError:
        return ConnectError("no route to host") if name in self._down else super().__getitem__(name)


@dataclass
class FakeFleet:
    """Hosts by name over one transport; ``down`` holds the names of hosts that are off."""

    hosts: dict[str, FakeHost]
    world: SharedEvents
    down: set[str] = field(default_factory=set)

    @classmethod
    def of(cls, names: Iterable[str]) -> "FakeFleet":
        world = SharedEvents()
        return cls(hosts={name: FakeHost(name, world) for name in names}, world=world)

    def __getitem__(self, name: str) -> FakeHost:
        return self.hosts[name]

    def copy(self) -> "FakeFleet":
        """Hosts of their own in the same state."""
        old = self.world
        world = SharedEvents(events=[*old.events], alive=copy.deepcopy(old.alive), overlap={*old.overlap})
        hosts = {
            name: replace(
                host,
                world=world,
                tasks=copy.deepcopy(host.tasks),
                faults={**host.faults},
                checks={**host.checks},
                seen={**host.seen},
            )
            for name, host in self.hosts.items()
        }
        return FakeFleet(hosts=hosts, world=world, down={*self.down})

    @property
    def transport(self) -> FakeTransport:
        handlers: dict[str, Handler | HostError] = {
            name: self._answer(host) for name, host in self.hosts.items()
        }
        return FakeTransport(_Reachable(handlers, self.down))

    def _answer(self, host: FakeHost) -> Callable[[Request], Request]:
        def answer(request: Request) -> Request:
            if host.name in self.down:
                raise ConnectError("no route to host")
            return host(request)

        return answer

    @property
    def changes(self) -> list[str]:
        """Return starts and stops, in order."""
        return [event for event in self.world.events if event.startswith(("start", "stop"))]

    @property
    def placed(self) -> dict[str, str]:
        """Return the host of each task."""
        return {task: host.name for host in self.hosts.values() for task in host.tasks}
