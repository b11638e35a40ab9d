# SPDX-License-Identifier: Apache-2.0
"""Pictures for the live view, and a view to press keys in."""

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field, replace

from textual.pilot import Pilot

from edgectl.errors import EdgectlError
from edgectl.model.inventory import Role
from edgectl.model.manager_state import ManagerState
from edgectl.model.point import HostPoint, TaskPoint
from edgectl.model.resource import Usage
from edgectl.model.snapshot import HostSample, HostStatus, TaskState
from edgectl.tui.app import TopApp
from edgectl.tui.backend import FleetBackend
from edgectl.tui.rows import Frame
from edgectl.views.top_hosts import group_points_by_host
from edgectl.views.top_tasks import group_points_by_task
from tests.builders import GI, NOW, a_run, a_sample, a_snapshot, a_task, an_edge, an_inventory, some_tasks
from tests.pace import patience

LIMIT_S = patience(60.0)
# What a host that means harm says: it must neither colour nor move anything.
HARM = "[red]no[/red] \x1b[2J\x9b1mroute"


def a_frame(cordons: frozenset[str] = frozenset()) -> Frame:
    """edge1 runs slam and a failed map, edge2 is silent, edge10 is busy with camera; idle runs nowhere."""
    slam = a_run(TaskState.READY, used=Usage(cpu=0.5, memory=2e8, network=3e5))
    failed = a_run(TaskState.FAILED, log_tail=("it broke", HARM))
    camera = a_run(TaskState.RUNNING, used=Usage(cpu=3.2, memory=1e8))
    snapshot = a_snapshot(
        memory=ManagerState(cordons=cordons),
        edge1=a_sample(used=0.6, used_memory=GI, tasks={"slam": slam, "map": failed}),
        edge2=HostSample(
            role=Role.EDGE,
            status=HostStatus.UNREACHABLE,
            error=HARM,
            error_kind="connect",
            hint="is it switched on?",
        ),
        edge10=a_sample(used=3.4, used_memory=3 * GI, tasks={"camera": camera}),
    )
    hosts = [
        HostPoint(
            at=NOW + at, host="edge1", status=HostStatus.OK, usage=a_sample(used=at, used_memory=GI).usage
        )
        for at in range(5)
    ]
    tasks = [
        TaskPoint(
            at=NOW + at,
            task="slam",
            host="edge1",
            state=TaskState.READY,
            used=Usage(cpu=at / 4, memory=1.0),
        )
        for at in range(5)
    ]
    tasks_of = some_tasks(a_task("camera", cpu=2.0), a_task("idle"), a_task("map"), a_task("slam", cpu=1.0))
    return Frame(
        snapshot=snapshot,
        inventory=an_inventory(*map(an_edge, snapshot.hosts)),
        tasks=tasks_of,
        host_points=group_points_by_host(hosts),
        task_points=group_points_by_task(tasks),
    )


@dataclass
class Bench:
    """What stands behind the view: each look gives the next of ``frames`` (an error: that look fails), then the last for ever."""

    frames: list[Frame | EdgectlError] = field(default_factory=lambda: [a_frame()])
    readonly: bool = False
    log: str | EdgectlError = "alive\n"
    asked: list[str] = field(default_factory=list)
    hang: threading.Event | None = None

    def view(self, *, every: float = 600.0) -> TopApp:
        """The view. It looks again where ``next`` says so."""
        return TopApp(
            FleetBackend(
                frames=self._frames,
                logs=self._logs,
                explain=lambda task: self._note(f"explain {task}") + "highest utility",
                cordon=None if self.readonly else self._cordon,
                restart=None if self.readonly else lambda task: self._note(f"restart {task}") + "done",
                drain=None if self.readonly else lambda host: self._note(f"drain {host}") + "done",
                open_shell=None if self.readonly else lambda host: len(self._note(f"shell {host}")),
            ),
            every=every,
            clock=lambda: NOW + 2.0,
        )

    def next(self, view: TopApp, *frames: Frame | EdgectlError) -> None:
        """Look again now, and see ``frames``."""
        self.frames = list(frames)
        view._again.set()

    def _frames(self, told_to_end: Callable[[], bool]) -> Iterator[Frame]:
        while True:
            if self.hang is not None:
                self.hang.wait()
            frame = self.frames.pop(0) if len(self.frames) > 1 else self.frames[0]
            if isinstance(frame, EdgectlError):
                raise frame
            yield frame
            if told_to_end():
                return

    def _logs(self, task: str) -> str:
        self.asked.append(f"logs {task}")
        if isinstance(self.log, EdgectlError):
            raise self.log
        return self.log

    def _note(self, text: str) -> str:
        self.asked.append(text)
        return ""

    def _cordon(self, host: str, close: bool) -> None:
        self.asked.append(f"{'cordon' if close else 'uncordon'} {host}")


def shown(view: TopApp) -> str:
    """The screen as a person sees it, without the blanks at the ends of lines."""
    strips = view.screen._compositor.render_strips()
    return "\n".join("".join(segment.text for segment in strip).rstrip() for strip in strips)


async def until(pilot: Pilot[None], view: TopApp, *texts: str, gone: bool = False) -> str:
    """Wait until every one of ``texts`` is (or none is any longer) on the screen."""
    end = time.monotonic() + LIMIT_S
    while not all((text in shown(view)) is not gone for text in texts):
        assert time.monotonic() < end, f"{texts} {'stay' if gone else 'never came'}:\n{shown(view)}"
        await pilot.pause(0.02)
    return shown(view)


async def eventually(pilot: Pilot[None], check: Callable[[], None]) -> None:
    """Wait until ``check`` finds nothing wrong; a screen is laid out in more than one step."""
    end = time.monotonic() + LIMIT_S
    while True:
        try:
            return check()
        except AssertionError:
            if time.monotonic() >= end:
                raise
        await pilot.pause(0.02)


def session(
    bench: Bench, act: Callable[[Pilot[None], TopApp], Awaitable[None]], *, size: tuple[int, int] = (80, 24)
) -> None:
    """Run a view without a terminal, from its first picture on."""

    async def run() -> None:
        view = bench.view()
        async with view.run_test(size=size) as pilot:
            if bench.hang is None and isinstance(bench.frames[0], Frame):
                await until(pilot, view, next(iter(bench.frames[0].snapshot.hosts)))
            await act(pilot, view)

    asyncio.run(run())


def crowded(hosts: int, tasks: int) -> Frame:
    """A fleet larger than the screen."""
    frame = a_frame()
    runs = {f"task{number}": a_run(used=Usage(cpu=0.01)) for number in range(tasks)}
    every = {
        f"edge{number}": replace(a_sample(used=1.0), tasks=runs if number == 0 else {})
        for number in range(hosts)
    }
    inventory = an_inventory(*map(an_edge, every))
    return Frame(
        snapshot=a_snapshot(every),
        inventory=inventory,
        tasks=some_tasks(*map(a_task, runs)),
        host_points=frame.host_points,
    )
