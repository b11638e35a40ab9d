# SPDX-License-Identifier: Apache-2.0
"""The live view, key by key, without a terminal."""

import threading
from dataclasses import replace

import pytest
from textual.pilot import Pilot

from edgectl.errors import LockBusyError, StateError
from edgectl.model.snapshot import LinkSample
from edgectl.model.task import Need
from edgectl.tui.app import TopApp
from edgectl.tui.tree import render_task_tree
from tests.builders import a_task, some_tasks
from tests.tui.frames import HARM, Bench, a_frame, crowded, eventually, session, shown, until


def test_fleet_health_tables_and_the_line_in_80_by_24() -> None:
    def check(view: TopApp) -> None:
        lines = shown(view).split("\n")
        assert len(lines) == 24
        assert max(map(len, lines)) <= 80
        assert lines[0].startswith("Fleet unnamed · ")
        assert lines[0].endswith(" · sample 2s old · 3 hosts (1 unreachable), 4 tasks")
        assert lines[1].startswith("2 problems: edge2 does not answer: [red]no[/red] \\x1b[2J")
        lines = lines[1:]
        assert lines[1].split() == ["HOST", "STATUS", "CPU", "MEMORY%", "TASKS"]
        assert [line.split()[0] for line in lines[2:5]] == ["edge1", "edge2", "edge10"]
        assert lines[2].split() == ["edge1", "ok", "0.60/4.00", "▁▃▅▇█", "25%", "▃▃▃▃▃", "1"]
        assert lines[3].split() == ["edge2", "unreachable", "-", "-", "-"]
        assert lines[5].split() == ["TASK", "HOST", "STATE", "AGE", "CPU/DEMAND", "MEMORY", "NETWORK"]
        assert [line.split()[:3] for line in lines[6:10]] == [
            ["camera", "edge10", "running"], ["idle", "-", "not"], ["map", "edge1", "failed"], ["slam", "edge1", "ready"],
        ]  # fmt: skip
        assert "3.20/2.00" in lines[6].split()
        assert "Name:        edge1" in lines, "what is left shows the line in full"
        assert " ".join(lines[-1].split()) == (
            "q Quit d Describe l Logs e Why t Tree r Restart x Drain s Shell ? Help"
        )

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await eventually(pilot, lambda: check(view))

    session(Bench(), act)


def test_the_head_shows_the_age_of_the_oldest_sample() -> None:
    frame = a_frame()
    edge10 = replace(frame.snapshot.hosts["edge10"], sample_age_s=5.0, resident=True)
    snapshot = replace(frame.snapshot, hosts={**frame.snapshot.hosts, "edge10": edge10})

    def check(view: TopApp) -> None:
        assert " · sample 7s old · " in shown(view).split("\n")[0]

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await eventually(pilot, lambda: check(view))

    session(Bench(frames=[replace(frame, snapshot=snapshot)]), act)


@pytest.mark.parametrize("size", [(80, 24), (160, 50)])
def test_sparklines_fill_the_width_and_no_more(size: tuple[int, int]) -> None:
    def check(view: TopApp, width: int) -> None:
        assert "NETWORK" in shown(view)
        hosts, tasks = (table.virtual_size.width for table in view.query("#hosts, #tasks"))
        assert width - 6 <= hosts <= width
        assert min(width, 110) - 6 <= tasks <= width

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await eventually(pilot, lambda: check(view, size[0]))
        await pilot.resize_terminal(100, 30)
        await eventually(pilot, lambda: check(view, 100))

    session(Bench(), act, size=size)


def test_more_than_fits_scrolls_and_the_cursor_stays() -> None:
    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await until(pilot, view, "task0")
        await pilot.press("tab", "ctrl+end")
        screen = await until(pilot, view, "task79", "q Quit")
        assert "task0 " not in screen
        assert "edge0" in screen, "the hosts keep their place"
        bench.next(view, crowded(12, 81))
        await until(pilot, view, "12 hosts", "task79")
        assert view._line("tasks").task == "task79"  # type: ignore[union-attr]

    bench = Bench(frames=[crowded(11, 80)])
    session(bench, act)


def test_filter() -> None:
    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("slash", *"slam")
        screen = await until(pilot, view, "camera", gone=True)
        assert "slam" in screen
        assert "only 'slam'" in screen
        await pilot.press("enter", "escape")
        assert "only" not in await until(pilot, view, "camera")
        await pilot.press("slash", *"q", "escape")
        await until(pilot, view, "camera")
        assert view.is_running, "q was typed, not pressed"

    session(Bench(), act)


def test_sort() -> None:
    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("o")
        screen = await until(pilot, view, "hosts by cpu")
        assert [line.split()[0] for line in screen.split("\n")[3:6]] == ["edge10", "edge1", "edge2"]
        await pilot.press("tab", "o", "o")
        screen = await until(pilot, view, "tasks by cpu")
        assert [line.split()[0] for line in screen.split("\n")[7:11]] == ["camera", "slam", "idle", "map"]

    session(Bench(), act)


def test_describe_a_host_that_means_harm() -> None:
    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("down", "d")
        screen = await until(pilot, view, "is it switched on?")
        assert "[red]no[/red] \\x1b[2J\\x9b1mroute" in screen
        await pilot.press("escape")
        await until(pilot, view, "is it switched on?", gone=True)

    session(Bench(), act)


def test_describe_a_task() -> None:
    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("tab", "down", "down", "d")
        screen = await until(pilot, view, "it broke")
        assert "failed" in screen
        assert "Command:" in screen
        assert "[red]no[/red] \\x1b[2J" in screen

    session(Bench(), act)


def test_logs() -> None:
    bench = Bench(log=f"line 1\n{HARM}\nlast line\n")

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("l")
        await until(pilot, view, "log needs a task")
        await pilot.press("tab", "l")
        screen = await until(pilot, view, "last line")
        assert "log of camera" in screen
        assert "[red]no[/red] \\x1b[2J" in screen

    session(bench, act)
    assert bench.asked == ["logs camera"]


def test_a_log_that_cannot_be_had_is_said() -> None:
    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("tab", "l")
        await until(pilot, view, "loading", gone=True)
        await until(pilot, view, "no answer from edge10", "Esc close")

    session(Bench(log=StateError("no answer from edge10")), act)


def test_cordon_asks_first() -> None:
    bench = Bench()

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        for answer in ("n", "escape", "enter", "y"):
            await pilot.press("c")
            await until(pilot, view, "Cordon edge1 (fleet unnamed)?")
            assert bench.asked == []
            await pilot.press(answer)
            await until(pilot, view, "Cordon edge1 (fleet unnamed)?", gone=True)
        await until(pilot, view, "edge1 cordoned")
        assert bench.asked == ["cordon edge1"]
        bench.next(view, a_frame(frozenset({"edge1"})))
        await until(pilot, view, "edge1   cordoned")  # the row; the note stands there already
        await pilot.press("c")
        await until(pilot, view, "Uncordon edge1 (fleet unnamed)?")
        await pilot.press("y")
        await until(pilot, view, "edge1 uncordoned")

    session(bench, act)
    assert bench.asked == ["cordon edge1", "uncordon edge1"]


def test_readonly_changes_nothing() -> None:
    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("c")
        screen = await until(pilot, view, "--readonly: nothing is changed")
        assert "to new tasks?" not in screen
        await pilot.press("x", "s")
        await until(pilot, view, "--readonly: no shell")

    session(Bench(readonly=True), act)


def test_help_says_every_key() -> None:
    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("question_mark")
        screen = await until(pilot, view, "Esc closes")
        assert all(f"│ {key} " in screen for key in "/odletrxcsq")
        await pilot.press("q")
        await until(pilot, view, "Esc closes", gone=True)
        assert view.is_running, "q closes what is on top"

    session(Bench(), act)


def test_a_look_that_fails_is_said_and_the_next_one_shown() -> None:
    bench = Bench(frames=[LockBusyError("the disk is full")])

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await until(pilot, view, "the disk is full")
        bench.next(view, a_frame())
        await until(pilot, view, "edge10")

    session(bench, act)


def test_quit_waits_for_no_host() -> None:
    bench = Bench(hang=threading.Event())

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        assert "measuring" in shown(view)
        await pilot.press("q")
        assert not view.is_running

    session(bench, act)
    assert bench.hang is not None
    bench.hang.set()


def test_restart_and_drain_ask_with_the_name_of_the_fleet() -> None:
    bench = Bench()

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("r")
        await until(pilot, view, "restart needs a task")
        await pilot.press("x")
        await until(pilot, view, "Cordon edge1 and move its tasks away (fleet unnamed)?")
        assert bench.asked == []
        await pilot.press("n", "tab", "r")
        await until(pilot, view, "Restart camera (fleet unnamed)?")
        await pilot.press("y")
        await until(pilot, view, "Restart camera (fleet unnamed)?", gone=True)
        await until(pilot, view, "done")

    session(bench, act)
    assert bench.asked == ["restart camera"]


def test_why_and_the_tree() -> None:
    bench = Bench()

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("tab", "e")
        await until(pilot, view, "explanation of camera", "highest utility")
        await pilot.press("escape", "t")
        await until(pilot, view, "Tasks below those that they need", "map  failed on edge1")
        await pilot.press("escape")
        await until(pilot, view, "Esc closes", gone=True)
        await pilot.press("e")
        await until(pilot, view, "explanation of camera", "highest utility")

    session(bench, act)
    assert bench.asked == ["explain camera", "explain camera"]


def test_a_shell_that_cannot_be_had_is_said() -> None:
    async def act(pilot: Pilot[None], view: TopApp) -> None:
        await pilot.press("s")
        await until(pilot, view, "no shell on edge1")
        assert view.is_running

    session(Bench(), act)


def test_the_tree_of_what_hangs_on_what() -> None:
    frame = a_frame()
    tasks = some_tasks(
        a_task("map"),
        a_task("slam", needs=(Need(task="map"),)),
        a_task("camera", needs=(Need(task="slam"), Need(task="map"))),
    )
    assert render_task_tree(replace(frame, tasks=tasks)).splitlines() == [
        "map  failed on edge1",
        "├─ camera  running on edge10",
        "└─ slam  ready on edge1",
        "   └─ camera  running on edge10",
    ]
    assert "`- slam" in render_task_tree(replace(frame, tasks=tasks), unicode=False)


def test_links_stand_in_a_table_of_their_own() -> None:
    frame = a_frame()
    edge1 = replace(
        frame.snapshot.hosts["edge1"],
        links={
            "robot2": LinkSample(capacity_bytes_per_s=1e6, used_bytes_per_s=9e5, rtt_ms=1.5),
            "robot1": LinkSample(capacity_bytes_per_s=0.0, used_bytes_per_s=0.0),
        },
    )
    seen = replace(frame.snapshot, hosts={**frame.snapshot.hosts, "edge1": edge1})

    async def act(pilot: Pilot[None], view: TopApp) -> None:
        screen = await until(pilot, view, "edge1 - robot2")
        lines = [" ".join(line.split()) for line in screen.split("\n")]
        at = lines.index("LINK USE USED CAPACITY RTT TASKS")
        assert lines[at + 1] == "edge1 - robot1 down 0B/s 0B/s - -"
        assert lines[at + 2] == "edge1 - robot2 90% 900.0kB/s 1.0MB/s 1.5ms -"

    session(Bench(frames=[replace(frame, snapshot=seen)]), act)
