# SPDX-License-Identifier: Apache-2.0
"""Process that stands for a container below its supervisor: it creates, starts and follows the container, and
ends as that ends.

Its record is on disk with the id of the container before the container runs. An engine that dies or is
restarted ends nothing here: the runner waits for it, and then goes on with a container that has survived, or
ends with the exit code of one that has not.
"""

import os
import time

from ..link import fast_json
from ..link.fast_json import Document
from ..measure import proc
from ..supervise import shell
from . import create, ending, engine, record

TYPE_CHECKING = False
if TYPE_CHECKING:
    from subprocess import Popen
    from typing import Callable, Mapping, Sequence

CREATE_S, START_S = 30.0, 40.0
_POLL_S = 0.03
# What both engines say of a name that another container has.
_NAME_IS_USED = "already in use"
# In place of the exit code of a container that somebody else removed: as if it was killed.
_REMOVED_EXIT = 137


class StartError(Exception):
    """The container cannot be started: why, and what helps."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message, self.hint = message, hint


class EngineLostError(Exception):
    """The engine does not answer."""


class ContainerRunner:
    """One container from its creation to its end."""

    # What is waited for while the container does not run; empty: the engine of this host. How long between
    # two looks at it.
    STARTER, RETRY_S = "", 1.0
    LOST_HINT = "start the engine there, or allow other hosts"

    def __init__(self, folder: str, identity: Document, spec: Document, notes: int) -> None:
        """``notes``: a pipe to the supervisor."""
        self._folder, self._identity, self._spec, self._notes = folder, identity, spec, notes
        self._set_variables(create.build_variables(spec, identity, folder))
        self._program, self._id = "", ""
        self._parent = os.getppid()
        self._found: Document = {}
        self._client: "Popen[bytes] | None" = None
        # Ended as its engine was shut down.
        self._went_along = False

    def run(self, *, patient: bool) -> int:
        """Create the container, start it and follow it; its exit code.

        ``patient``: wait for an engine that does not answer.

        Raises:
            StartError: it cannot be started.
        """
        self._program = engine.choose_program(self._spec["image"].get("engine"))
        if not patient:
            ending.await_removal(self._folder)
        return self._bring_up((self._create, self._start), patient=patient)

    def _set_variables(self, variables: "Mapping[str, str]") -> None:
        """Set the environment of the container, and that of the engine's program, which passes it on."""
        self._variables = dict(variables)
        self._env = create.build_engine_environment(shell.build_environment(None), self._variables)

    def _bring_up(self, steps: "Sequence[Callable[[], None]]", *, patient: bool) -> int:
        """Start the container by ``steps``, or else from its creation, and follow it; its exit code."""
        while not self._try_start(steps, patient=patient):
            self._note_loss(alive=False)
            self._pause()
            steps = (self._create, self._start)
        self._note_return()
        self._note_start()
        return self._follow()

    def _try_start(self, steps: "Sequence[Callable[[], None]]", *, patient: bool) -> bool:
        """Whether the container runs; False where the engine does not answer and ``patient``. What cannot be
        started is removed; False also where that cannot be proven.
        """
        try:
            for step in steps:
                step()
        except EngineLostError as error:
            if patient or not self._is_taken_back():
                return False
            raise StartError(str(error), self.LOST_HINT) from None
        except StartError:
            if not self._is_taken_back():
                return False
            raise
        return True

    def _is_taken_back(self) -> bool:
        """Remove what was created: whether it is certain that it never starts."""
        ending.remove_containers(self._folder, self._program)
        return not record.may_start(self._folder)

    def resume(self) -> int:
        """Follow the container that the record names; its exit code."""
        self._found = record.read_container(self._folder)
        self._program, self._id = str(self._found["program"]), str(self._found["id"])
        self._note_start()
        return self._follow()

    def _note(self, **event: object) -> None:
        """Tell the supervisor, which may be gone."""
        try:
            os.write(self._notes, fast_json.dumps(event).encode("ascii") + b"\n")
        except OSError:
            pass

    def _note_start(self) -> None:
        known = self._found
        self._note(
            event="started",
            pid=known.get("pid", 0),
            ticks=known.get("ticks", -1),
            name=str(known.get("name") or ""),
        )

    def _write(self, **changes: object) -> None:
        self._found = dict(self._found, **changes)
        durable = "id" in changes
        try:
            record.write_container(self._folder, self._found, durable=durable)
        except OSError:
            # Without the id on disk nothing is started; what else changes can be asked for again.
            if durable and (changes["id"] or changes.get("pending")):
                raise

    def _pause(self) -> None:
        time.sleep(self.RETRY_S)
        if os.getppid() != self._parent and not self._list_inside():
            # Nobody waits for a container that does not run.
            os._exit(1)

    def _list_inside(self) -> "set[int]":
        return record.find_processes_by_id(self._id, proc.read_process_table())

    def _note_loss(self, *, alive: bool) -> None:
        if not self._found.get("lost") or bool(self._found.get("alive")) != alive:
            self._write(lost=True, alive=alive)
            starter = "" if alive else self.STARTER
            name = starter or os.path.basename(self._program)
            self._note(event="lost", alive=alive, engine=name, asked=bool(starter))

    def _note_return(self) -> None:
        if self._found.get("lost"):
            self._write(lost=False)
            self._note(event="back")

    def _check(self, call: engine.EngineCall) -> engine.EngineCall:
        if call.kind == engine.LOST:
            raise EngineLostError(call.why)
        return call

    def _create(self) -> None:
        """Create the container and record it; what an earlier run has left of it is removed first."""
        self._id = ""
        if record.read_container(self._folder).get("place"):
            # It was a service until now.
            ending.remove_containers(self._folder)
        self._write(
            id="",
            run=os.urandom(6).hex(),
            program=self._program,
            name=self._variables[create.NAME_VARIABLE],
            image=self._spec["image"]["name"],
            instance=self._identity["instance"],
            pid=0,
            ticks=-1,
        )
        left, call = ending.list_containers(self._program, self._folder)
        if self._check(call).kind != engine.DONE:
            raise StartError(call.why, _build_hint(call.why))
        if left:
            self._check(engine.call_engine([self._program, "rm", "--force", "--volumes", *left], CREATE_S))
        argv = create.build_create_argv(
            self._program, self._spec, self._identity, self._folder, self._variables
        )
        call = self._check(engine.call_engine(argv, CREATE_S, self._env))
        if _NAME_IS_USED in call.why and ending.remove_lost(self._program, self._identity):
            call = self._check(engine.call_engine(argv, CREATE_S, self._env))
        if call.kind != engine.DONE:
            raise StartError(*self._explain_refusal(call.why))
        self._id = call.out.split()[-1] if call.out.split() else ""
        self._write(id=self._id)

    def _explain_refusal(self, why: str) -> "tuple[str, str]":
        """Why the container was not created, and what helps."""
        if _NAME_IS_USED in why:
            name = self._variables[create.NAME_VARIABLE]
            message = "a container %s exists that is not of this task; it was not touched" % name
            return message, "rename or remove it there"
        return why, _build_hint(why)

    def _start(self) -> None:
        """Start the container, attached to the log; return once it runs or has run."""
        self._open_client(["start", "--attach", self._id])
        deadline = time.monotonic() + START_S
        while True:
            ended = self._client is not None and self._client.poll() is not None
            if ended or self._list_inside():
                call, state = engine.inspect_state(self._program, self._id)
                self._check(call)
                if call.kind != engine.DONE:
                    raise StartError(call.why)
                if state.get("Running") or has_run(state):
                    pids, table = self._list_inside(), proc.read_process_table()
                    pid, ticks = record.find_first_process(pids, table)
                    return self._write(pid=pid, ticks=ticks)
                if ended:
                    why = str(state.get("Error") or "") or "the container did not start"
                    raise StartError(why[:300], "check command, user, devices and volumes of the task")
            if time.monotonic() > deadline:
                raise EngineLostError("the container did not start within %g s" % START_S)
            time.sleep(_POLL_S)

    def _open_client(self, words: "Sequence[str]") -> None:
        """Attach the program of the engine to this process's output, which is the log."""
        import subprocess

        self._client = subprocess.Popen(
            [self._program, *words], stdin=subprocess.DEVNULL, env=self._env, cwd="/", start_new_session=True
        )

    def _follow(self) -> int:
        """Wait for the end of the container, whatever becomes of the engine; its exit code."""
        while True:
            if self._client is not None:
                self._client.wait()
            call, state = engine.inspect_state(self._program, self._id)
            if call.kind == engine.GONE:
                return self._end(_REMOVED_EXIT, "another program removed its container")
            if call.kind != engine.DONE:
                alive = bool(self._list_inside())
                # An engine that is told to end takes no more calls first, and ends its containers then.
                self._went_along |= call.refused and not alive and not self._found.get("lost")
                self._note_loss(alive=alive)
                self._client = None
                self._pause()
                continue
            self._note_return()
            if not state.get("Running") and not self._list_inside():
                return self._end_after(state)
            self._open_client(["attach", "--no-stdin", "--sig-proxy=false", self._id])
            # A container that ends just now refuses it at once.
            time.sleep(_POLL_S)

    def _end_after(self, state: Document) -> int:
        """End with the exit code of a container that has ended. Where that is 0, the supervisor hears
        whether it was told to end, and has not done its work.
        """
        code = int(state.get("ExitCode") or 0)
        if code == 0 and (self._went_along or engine.was_told_to_end(self._program, self._id)):
            self._note(event="interrupted")
        return self._end(code, "killed: out of memory" if state.get("OOMKilled") else "")

    def _end(self, code: int, detail: str) -> int:
        """Remove the container; what cannot be removed now is removed before the next start, by a stop, or
        once the task is dead.
        """
        call = engine.call_engine([self._program, "rm", "--volumes", self._id])
        if call.kind in (engine.DONE, engine.GONE):
            record.note_removal(self._folder, self._found)
        self._write(id="", pid=0, ticks=-1)
        if detail:
            self._note(event="ended", detail=detail)
        return code


def has_run(state: Document) -> bool:
    """Whether a container in ``state`` ran and has ended already."""
    return state.get("Status") in ("exited", "dead") and not str(state.get("StartedAt", "")).startswith(
        "0001"
    )


def _build_hint(why: str) -> str:
    """What helps against an error of the engine."""
    words = why.lower()
    if "permission denied" in words:
        return "add the user to the group docker there, and log in again"
    if "no such image" in words or "not known" in words:
        return "apply pulls it: edgectl restart the task, or write pull: missing"
    return "check image, devices, volumes and args of the task"
