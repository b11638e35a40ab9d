# SPDX-License-Identifier: Apache-2.0
"""The mission's programs do real work, and do it right: the world, the sensors, the map, the detection, the drive."""

import math
import random
import subprocess
import sys
import threading
import time
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tests.experiments.lab.patrol import PATROL, detection, follower, grid, mapper, radio, robot, wire, world
from tests.pace import patience

PLAN = world.Plan()
COLUMN, ROW = st.integers(0, world.WIDTH - 1), st.integers(0, world.HEIGHT - 1)
STANDING = [point for number in (3, 2, 1) for point in PLAN.tour(number)]


def test_the_true_map_is_made_by_its_generator(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(PATROL / "world.py"), str(tmp_path)], check=True)
    for name in ("world.pgm", "world.yaml"):
        assert (tmp_path / name).read_bytes() == (PATROL / name).read_bytes()


def test_the_programs_run_on_python_3_8() -> None:
    vermin = Path(sys.executable).parent / "vermin"
    done = subprocess.run(
        [vermin, "-q", "--no-tips", "-t=3.8-", "--violations", PATROL],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("number", [3, 2, 1])
def test_a_robot_can_drive_its_tour(number: int) -> None:
    tour = PLAN.tour(number)
    for (x0, y0), (x1, y1) in pairwise(tour):
        for part in range(101):
            x, y = x0 + (x1 - x0) * part / 100, y0 + (y1 - y0) * part / 100
            assert all(PLAN.free(x + dx, y + dy) for dx in (-0.15, 0.15) for dy in (-0.15, 0.15)), (x, y)


@given(st.sampled_from(STANDING), st.floats(-math.pi, math.pi))
def test_a_ray_ends_where_the_first_solid_cell_begins(stand: tuple[float, float], angle: float) -> None:
    far = world.cast(PLAN.solid, *stand, angle, 20.0)
    step = 0.002
    walked = next(
        n
        for n in range(20000)
        if not PLAN.free(stand[0] + n * step * math.cos(angle), stand[1] + n * step * math.sin(angle))
    )
    # Small steps may jump over a corner that the ray touches, never the other way round.
    assert far <= walked * step + 1e-9
    assert not PLAN.free(stand[0] + (far + 1e-6) * math.cos(angle), stand[1] + (far + 1e-6) * math.sin(angle))


def test_a_ray_has_an_end() -> None:
    assert world.cast(PLAN.solid, *STANDING[0], 0.0, 1.0) == 1.0


@given(COLUMN, ROW, COLUMN, ROW)
def test_a_line_goes_from_cell_to_cell_and_stays_near_the_straight_one(
    x0: int, y0: int, x1: int, y1: int
) -> None:
    cells = [(cell % world.WIDTH, cell // world.WIDTH) for cell in grid.line(x0, y0, x1, y1)]
    assert len(cells) == max(abs(x1 - x0), abs(y1 - y0))
    whole = [*cells, (x1, y1)]
    assert whole[0] == (x0, y0)
    assert all(max(abs(a - c), abs(b - d)) == 1 for (a, b), (c, d) in pairwise(whole))
    length = math.hypot(x1 - x0, y1 - y0) or 1.0
    assert all(abs((x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)) / length <= 0.5 + 1e-9 for x, y in whole)


def a_scan(x: float, y: float, angle: float = 0.0) -> "array[int]":
    found = (world.cast(PLAN.solid, x, y, angle + beam * math.tau / 360, mapper.REACH) for beam in range(360))
    return array("H", (int(1000 * far) if far < mapper.REACH else 0 for far in found))


def test_one_scan_frees_what_is_seen_and_marks_what_is_hit() -> None:
    x, y = STANDING[1]
    cells = grid.empty()
    grid.learn(cells, (x, y, 0.0), a_scan(x, y), mapper.REACH)
    known = [cell for cell in range(len(cells)) if cells[cell]]
    wrong = [cell for cell in known if (cells[cell] > 0) != bool(PLAN.solid[cell])]
    assert len(known) > 1000
    assert len(wrong) < 0.05 * len(known)


def test_a_pose_that_is_a_little_off_is_brought_back() -> None:
    x, y = STANDING[1]
    cells = grid.empty()
    for _ in range(3):
        grid.learn(cells, (x, y, 0.0), a_scan(x, y), mapper.REACH)
    off = (x + 0.025, y - 0.025, 0.01)
    better = grid.fit(cells, off, a_scan(x, y))
    assert math.dist(better, (x, y, 0.0)) < math.dist(off, (x, y, 0.0)) / 2


def test_maps_add_up_and_stay_in_bounds() -> None:
    one, other = grid.empty(), grid.empty()
    one[0], one[1], one[2] = 90, -9, 0
    other[0], other[1], other[2] = 90, 3, 20
    both = grid.merged([one, other])
    assert list(both[:4]) == [grid.SUREST, -6, 20, 0]
    assert list(grid.picture(both)[:4]) == [world.OCCUPIED, world.FREE, world.OCCUPIED, world.UNKNOWN]


def test_a_mean_is_the_mean_of_its_square() -> None:
    draw = random.Random(3)
    rows = [[draw.randrange(256) for _ in range(9)] for _ in range(7)]
    found = detection.averaged(rows, 2)
    for row in range(7):
        for column in range(9):
            around = [
                rows[r][c]
                for r in range(max(0, row - 2), min(7, row + 3))
                for c in range(max(0, column - 2), min(9, column + 3))
            ]
            assert found[row][column] == sum(around) // len(around)


def test_every_ball_in_sight_is_found_where_it_is() -> None:
    draw, sought = random.Random(5), 0
    focal = robot.COLUMNS / 2 / math.tan(robot.FIELD / 2)
    for x, y in STANDING[1::6]:
        for turn in range(0, 360, 30):
            pose = (x, y, math.radians(turn))
            pixels, shown = robot.picture(PLAN, pose, draw)
            found = detection.detect(pixels, robot.COLUMNS)
            near = [middle for _, middle, _ in robot.balls(PLAN, pose, focal)]
            assert len(found) >= shown
            assert all(min(abs(column - middle) for middle in near) < 4 for column, _ in found), (
                "nothing is found where nothing is"
            )
            sought += shown
    assert sought > 10


def test_nothing_is_found_in_noise() -> None:
    pixels = random.Random(2).randbytes(robot.COLUMNS * robot.ROWS)
    assert detection.detect(bytes(100 + pixel % 16 for pixel in pixels), robot.COLUMNS) == []


def a_robot() -> "robot.Robot":
    """It stands at the begin of its tour at 0 s, and knows what it saw just before."""
    made = robot.Robot(1)
    made.moved = 0.0
    for sense in made.senses.values():
        sense.note(sense.take(-0.1), "edge1/1", 0.0)
    return made


def test_a_robot_moves_as_told_and_stops_by_itself() -> None:
    made = a_robot()
    x = made.x
    made.forward, made.told = 1.0, 0.0
    made.move(0.2)
    assert made.x == pytest.approx(x + 0.2)
    made.move(60.0)
    assert made.x == pytest.approx(x + robot.STALE_S)
    made.move(120.0)
    assert made.x == pytest.approx(x + robot.STALE_S)


def test_a_wall_stops_a_robot() -> None:
    made = a_robot()
    for second in range(1, 100):
        made.forward, made.told = 1.0, float(second)
        made.moved = float(second)
        made.move(second + 0.4)
    assert PLAN.free(made.x, made.y)
    assert made.x < world.metres(world.WIDTH - world.WALL)


def test_steering_turns_first_and_slows_down() -> None:
    assert follower.steer([0.0, 0.0, 0.0], [3.0, 0.0], 1.5) == (1.5, 0.0)
    assert follower.steer([0.0, 0.0, 0.0], [0.1, 0.0], 1.5)[0] == pytest.approx(0.3)
    forward, turn = follower.steer([0.0, 0.0, 0.0], [0.0, 3.0], 1.5)
    assert (forward, turn) == (0.0, follower.FASTEST_TURN)


def test_a_robot_is_as_slow_as_its_results_are_old() -> None:
    made = a_robot()
    assert made.safe_speed(0.4) == pytest.approx(robot.SIGHT / 0.5)
    made.senses["scan"].note(made.senses["scan"].take(0.4), "edge1/1", 0.4)
    assert made.safe_speed(0.4) == pytest.approx(robot.SIGHT / 0.5), "the older of both senses counts"
    made.senses["frame"].note(made.senses["frame"].take(0.4), "edge1/1", 0.4)
    assert made.safe_speed(0.4) == pytest.approx(robot.SIGHT / robot.LEAST_AGE_S)
    x = made.x
    made.forward, made.told = 1.5, 100.0
    made.moved = 100.0
    made.move(100.4)
    assert made.x - x < 0.01, "it does not drive on results of long ago"
    assert robot.Robot(1).safe_speed(0.0) == 0.0, "nor without any"


def test_a_sense_knows_the_age_of_a_result_and_the_gap_of_a_move() -> None:
    sense = robot.Sense()
    first, second, third = (sense.take(at) for at in (1.0, 2.0, 3.0))
    assert sense.note(first, "edge1/7", 1.25) == (0.25, 0.0)
    assert sense.note(second, "edge1/7", 2.5) == (0.5, 0.0)
    assert sense.note(third, "edge2/9", 4.0) == (1.0, 1.5), (
        "silent from 2.5 to 4 s, when another instance spoke"
    )
    assert (sense.results, sense.seen) == (3, 3.0)


def test_a_mapper_knows_a_place_again_and_works_more_with_each() -> None:
    known = mapper.Map(grid.empty(), [])
    x, y = STANDING[1]
    far = STANDING[4]
    assert not known.learn([x, y, 0.0], a_scan(x, y))
    assert len(known.places) == 1
    assert known.learn([x, y, 1.0], a_scan(x, y, 1.0)), "from the same place in another direction"
    assert not known.learn([*far, 0.0], a_scan(*far))
    assert len(known.places) == 1 + 2 // mapper.PLACE_EVERY


@contextmanager
def serving(made: "robot.Robot") -> Iterator["wire.Link"]:
    with robot.Server(("127.0.0.1", 0), robot.Session) as server:
        server.robot = made
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        link = wire.Link("127.0.0.1", "robot1")
        link.where = ("127.0.0.1", server.server_address[1])
        try:
            yield link
        finally:
            link.close()
            server.shutdown()
            thread.join()


def test_a_mapper_elsewhere_goes_on_with_the_map() -> None:
    made = robot.Robot(1)
    with serving(made) as link:
        assert mapper.begin(link).cells == grid.empty()
        first = mapper.Map(grid.empty(), [array("H", range(mapper.BEAMS))])
        first.cells[7] = 42
        mapper.leave_map(link, first, "map")
        again = mapper.begin(link)
        assert (again.cells, again.places) == (first.cells, first.places)
        made.over = True
        assert mapper.work(link, first, 100.0, mapper.Leave())


def test_a_result_is_as_old_as_its_picture_by_the_clock_of_the_robot() -> None:
    made = robot.Robot(1)
    with serving(made) as link:
        header, pixels = link.ask("frame")
        assert len(pixels) == robot.COLUMNS * robot.ROWS
        time.sleep(0.05)
        assert 50.0 <= wire.give_result(link, "frame", header["number"]) < 1000.0 * wire.PATIENCE_S
        assert link.ask("pose")[0]["taken"] == {"frame": 1, "scan": 0}


def test_who_reads_the_pipe_hears_of_the_next_result(tmp_path: Path) -> None:
    """By the command that tasks.yaml states; nobody needs to listen, and the pipe survives a restart of the robot."""
    made = robot.Robot(1)
    for _ in range(2):
        robot.make_pipes(made, "robot1", tmp_path / "edgectl-patrol")
    command = yaml.safe_load((PATROL / "tasks.yaml").read_text())["tasks"]["detection"]["heard"]
    words = ["sh", "-c", command.replace("{robot}", "robot1")]
    with serving(made) as link:
        number = link.ask("frame")[0]["number"]
        wire.give_result(link, "frame", number)
        listening = subprocess.Popen(words, env={"HOME": str(tmp_path)})
        try:
            with pytest.raises(subprocess.TimeoutExpired):
                listening.wait(0.3)
            wire.give_result(link, "scan", link.ask("scan")[0]["number"])
            with pytest.raises(subprocess.TimeoutExpired):
                listening.wait(0.3)
            wire.give_result(link, "frame", number)
            assert listening.wait(patience(20)) == 0
        finally:
            listening.kill()
            listening.wait()


def test_a_radio_without_links_to_shape_says_so(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("EDGECTL_PATROL_RADIO", raising=False)
    monkeypatch.setattr(sys, "argv", ["radio.py", "robot1=edge1"])
    assert radio.main() == 0
    assert capsys.readouterr().out == "no links to shape here\n"


def test_metrics_are_lines_of_name_and_value(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("EDGECTL_METRICS", raising=False)
    wire.report(fps=1.0)
    monkeypatch.setenv("EDGECTL_METRICS", str(tmp_path / "metrics"))
    wire.report(fps=9.87654, recall=1)
    assert (tmp_path / "metrics").read_text() == "fps 9.877\nrecall 1.000\n"
    assert capsys.readouterr().out == "fps=1.000\nfps=9.877 recall=1.000\n"
