# SPDX-License-Identifier: Apache-2.0
"""Process that stands for the service of a task in a Docker Swarm, as `runner` does for a container.

The record says before the swarm is asked that a container may start here at any time; it says so until that
was seen running, or a manager has removed the service. Who may restart is the supervisor, as always: by a new
service.
"""

import os
import time

from ..link.fast_json import Document
from ..measure import proc, system_files
from . import ending, engine, record, service, swarm
from .runner import START_S, ContainerRunner, EngineLostError, StartError, has_run

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Callable, Sequence

# Between two looks for the container, which mostly runs within half a second, and questions for its fault.
_LOOK_S, _LATER_S, _ASK_S = 0.2, 1.0, 2.0


class ServiceRunner(ContainerRunner):
    """One service, whose container is on this node, from its creation to its end."""

    # Each look takes several calls.
    STARTER, RETRY_S = "the swarm", 5.0
    LOST_HINT = "edgectl doctor names what is missing there; or allow other hosts"

    def __init__(self, folder: str, identity: Document, spec: Document, notes: int, lock: int) -> None:
        """``lock`` of the task: what asks the swarm holds it, too."""
        super().__init__(folder, identity, spec, notes)
        self._set_variables(service.build_service_variables(self._variables))
        self._lock = lock
        names = (identity[name] for name in ("fleet", "host", "task"))
        self._name = service.build_service_name(*names)
        self._managers = ["", *(spec["image"].get("managers") or [])]

    def resume(self) -> int:
        """As of a container; one that has not started yet is waited for."""
        self._found = record.read_container(self._folder)
        self._program = str(self._found["program"])
        if not self._found.get("pending"):
            return super().resume()
        return self._bring_up((self._start,), patient=True)

    def _try_start(self, steps: "Sequence[Callable[[], None]]", *, patient: bool) -> bool:
        try:
            return super()._try_start(steps, patient=patient)
        finally:
            # A removal writes it, too.
            self._found = record.read_container(self._folder)

    def _create(self) -> None:
        """Remove what an earlier run has left, record what is asked for, and ask the swarm."""
        self._id = ""
        why = ending.remove_containers(self._folder, self._program)
        if why:
            raise EngineLostError(why)
        node, is_manager = self._find_node()
        image_id, place = self._find_image(), service.build_place(node, self._folder)
        left, call = swarm.list_services(self._program, self._managers, place)
        if self._check(call).kind != engine.DONE:
            raise StartError(call.why)
        if left:
            # Their record is lost.
            self._write_request(place, left)
            why = ending.remove_containers(self._folder, self._program)
            if why:
                raise EngineLostError(why)
        self._write_request(place, [])
        words = service.build_service_words(
            self._name, node, image_id, self._spec, self._identity, self._folder, self._variables
        )
        keep = (self._lock,) if self._lock >= 0 else ()
        # A worker would answer that there is no such network.
        managers = self._managers if is_manager else self._managers[1:]
        call = swarm.call_managers(self._program, managers, words, swarm.REQUEST_S, self._env, keep)
        if self._check(call).kind != engine.DONE:
            self._write(asked=0.0)  # it was answered
            raise StartError(*self._explain_refusal(call.why))
        self._write(services=[call.out.split()[-1][:12]] if call.out.split() else [])

    def _write_request(self, place: str, services: "Sequence[str]") -> None:
        """Record that the swarm may start the container from now on."""
        self._found = {name: self._found[name] for name in ("lost", "alive") if name in self._found}
        self._write(
            id="",
            run=os.urandom(6).hex(),
            program=self._program,
            name="",
            image=self._spec["image"]["name"],
            instance=self._identity["instance"],
            managers=self._managers,
            place=place,
            service=self._name,
            services=list(services),
            asked=round(proc.read_uptime_s(), 2),
            boot_id=system_files.read_boot_id(),
            pending=True,
            pid=0,
            ticks=-1,
        )

    def _find_node(self) -> "tuple[str, bool]":
        """Find the id of this node, and whether it is a manager."""
        call, found = swarm.read_node(self._program)
        if self._check(call).kind != engine.DONE:
            raise StartError(call.why)
        if found.get("LocalNodeState") != "active" or not found.get("NodeID"):
            raise StartError(swarm.NOT_A_NODE, "docker swarm join there, or write engine: docker")
        return str(found["NodeID"]), bool(found.get("ControlAvailable"))

    def _find_image(self) -> str:
        argv = [self._program, "image", "inspect", "--format", "{{.Id}}", self._spec["image"]["name"]]
        call = self._check(engine.call_engine(argv))
        if call.kind != engine.DONE:
            raise StartError(*self._explain_refusal(call.why))
        return call.out.strip()

    def _explain_refusal(self, why: str) -> "tuple[str, str]":
        """Why there is no service, and what helps."""
        if swarm.is_name_taken(why):
            message = "a service %s exists that is not of this task; it was not touched" % self._name
            return message, "rename or remove it"
        return super()._explain_refusal(why)

    def _start(self) -> None:
        """Wait until the swarm has started the container on this node."""
        deadline, next_ask = time.monotonic() + START_S, time.monotonic() + _ASK_S
        pause_s = _LOOK_S
        while not self._look():
            if time.monotonic() > next_ask:
                fault = swarm.find_service_fault(self._program, self._managers, self._name)
                if fault:
                    raise StartError(fault[:300], "check command, user and volumes of the task")
                next_ask, pause_s = time.monotonic() + _ASK_S, _LATER_S
            if time.monotonic() > deadline:
                what = swarm.describe_wait(self._program, self._managers, self._name)
                raise EngineLostError("the swarm did not start the service within %g s: %s" % (START_S, what))
            time.sleep(pause_s)

    def _look(self) -> bool:
        """Whether the container runs or has run; then its output is followed from the beginning."""
        ids, call = ending.list_containers(self._program, self._folder)
        if self._check(call).kind != engine.DONE or not ids:
            return False
        if ids[0] != self._id:
            self._id = ids[0]
            self._write(id=self._id)
        call, state = engine.inspect_state(self._program, self._id)
        self._check(call)
        if not (state.get("Running") or has_run(state)):
            return False
        pid, ticks = record.find_first_process(self._list_inside(), proc.read_process_table())
        self._write(id=self._id, pid=pid, ticks=ticks, name=self._read_name(), pending=False)
        self._open_client(["logs", "--follow", self._id])
        return True

    def _read_name(self) -> str:
        call = engine.call_engine(
            [self._program, "inspect", "--type", "container", "--format", "{{.Name}}", self._id]
        )
        return call.out.strip().lstrip("/") if call.kind == engine.DONE else ""

    def _end(self, code: int, detail: str) -> int:
        """Remove the service and the container; what no manager can remove now is removed later."""
        swarm.remove_service(self._folder)
        self._found = record.read_container(self._folder)
        return super()._end(code, detail)
