"""A simulated robot: it drives through the world on command, serves its sensor readings, and keeps data of
other programs on a blackboard.

    python3 robot.py [--check]
    read -r _ <"$HOME/edgectl-patrol/frame-robot1"      returns when robot1 has another result of that sense

Serves over TCP at its own address ($EDGECTL_ROBOT_HOST), port 27000 and the number in its name: ``frame`` (a
camera image), ``scan`` (laser ranges), ``result`` (of what was found in one of them), ``pose``, ``drive`` (a
velocity; the robot stops half a second after the last one), ``put`` and ``get`` (the blackboard), ``over``
(end of the mission). The robot knows how old the data is of which it has results, and drives no further than
0.75 m without newer ones. Metrics: ``gap_ms``, how long a sense had no results while its task moved.
``--check`` exits with 0 if it serves. TERM ends it. Python >= 3.8, standard library only.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import random
import socketserver
import sys
import threading
import time
from array import array
from pathlib import Path

import wire
import world

BEAMS, REACH, SCAN_NOISE = 360, 3.5, 0.01
COLUMNS, ROWS, FIELD, STRIPE = 320, 240, math.pi / 2, 4
CEILING, FLOOR, LIGHT, BALL = 96, 72, 110, 215
BALL_RADIUS = 0.12
POSE_NOISE, TURN_NOISE = 0.01, 0.005
STALE_S = 0.5
SIGHT, LEAST_AGE_S = 0.75, 0.05


class Sense:
    """What is known of one sense: when its data was ``taken`` (by number), and when that of the newest result
    was (``seen``).

    ``who`` gave that result, and ``at`` what time; ``results``: how many there are.
    """

    def __init__(self) -> None:
        self.number, self.results, self.seen = 0, 0, -math.inf
        self.taken: dict[int, float] = {}
        self.who, self.at = "", 0.0

    def take(self, now: float) -> int:
        """The number of data that is taken now."""
        self.number += 1
        self.taken[self.number] = now
        self.taken.pop(self.number - 100, None)
        return self.number

    def note(self, number: int, who: str, now: float) -> tuple[float, float]:
        """Take in a result for data of this number: how old that data is, and, if another one has taken
        over, for how long nothing had come (s; else 0).
        """
        taken = self.taken.get(number, now)
        gap = now - self.at if self.who not in ("", who) else 0.0
        self.results, self.seen = self.results + 1, max(self.seen, taken)
        self.who, self.at = who, now
        return now - taken, gap


class Robot:
    """Where it is, what it was told, and what it holds for others.

    ``pipes``: by sense, where to tell of a result.
    """

    def __init__(self, number: int, seed: int = world.SEED) -> None:
        self.plan = world.Plan(seed)
        self.tour = self.plan.tour(number)
        self.x, self.y, self.angle = (*self.tour[0], 0.0)
        self.forward, self.turn, self.told = 0.0, 0.0, 0.0
        self.moved = time.monotonic()
        self.draw = random.Random(seed * 1000 + number)
        self.lock = threading.Lock()
        self.board: dict[str, bytes] = {}
        self.senses = {"frame": Sense(), "scan": Sense()}
        self.pipes: dict[str, str] = {}
        self.over = False

    def safe_speed(self, now: float) -> float:
        """How fast it may drive (m/s): `SIGHT` in the time since what it knows was seen."""
        return SIGHT / max(LEAST_AGE_S, now - min(sense.seen for sense in self.senses.values()))

    def move(self, now: float) -> None:
        """Be where the last command has led until ``now``; a wall stops it."""
        until = min(now, self.told + STALE_S)
        at, self.moved = self.moved, now
        while at < until:
            step = min(until - at, 0.02)
            at += step
            self.angle = math.remainder(self.angle + self.turn * step, 2 * math.pi)
            way = min(self.forward, self.safe_speed(at)) * step
            x, y = self.x + way * math.cos(self.angle), self.y + way * math.sin(self.angle)
            if self.plan.free(x, y):
                self.x, self.y = x, y

    def scan(self) -> bytes:
        """Distances in mm all around, from straight ahead to the left; 0 where nothing is within reach."""
        found = array("H")
        for beam in range(BEAMS):
            far = world.cast(self.plan.solid, self.x, self.y, self.angle + beam * 2 * math.pi / BEAMS, REACH)
            found.append(int(1000 * max(0.02, far + self.draw.gauss(0.0, SCAN_NOISE))) if far < REACH else 0)
        return found.tobytes()

    def frame(self) -> tuple[bytes, int]:
        """What the camera sees, a byte per pixel, row by row from above.

        And how many balls are in it, whole and in sight.
        """
        return picture(self.plan, (self.x, self.y, self.angle), self.draw)

    def believed(self) -> tuple[float, float, float]:
        """Where it thinks that it is."""
        near = self.draw.gauss
        return (
            self.x + near(0.0, POSE_NOISE),
            self.y + near(0.0, POSE_NOISE),
            self.angle + near(0.0, TURN_NOISE),
        )


def picture(plan: world.Plan, pose: tuple[float, float, float], draw: random.Random) -> tuple[bytes, int]:
    """The walls that a camera sees from a pose, the balls before them, and noise.

    And how many balls are whole and in sight.
    """
    x, y, angle = pose
    focal = COLUMNS / 2 / math.tan(FIELD / 2)
    depths, stripes = [], []
    for left in range(0, COLUMNS, STRIPE):
        aside = math.atan2(COLUMNS / 2 - left - STRIPE / 2, focal)
        depth = max(0.1, world.cast(plan.solid, x, y, angle + aside, 9.0) * math.cos(aside))
        half = min(ROWS // 2, int(focal * 0.5 / depth))
        wall = bytes([int(LIGHT - 6 * min(depth, 5.0))]) * (2 * half)
        depths.append(depth)
        stripes += [
            bytes([CEILING]) * (ROWS // 2 - half) + wall + bytes([FLOOR]) * (ROWS // 2 - half)
        ] * STRIPE
    pixels = bytearray().join(map(bytes, zip(*stripes)))
    shown = sum(paint(pixels, depths, ball) for ball in sorted(balls(plan, pose, focal), reverse=True))
    noise = draw.getrandbits(8 * len(pixels)) & int.from_bytes(b"\x0f" * len(pixels), "big")
    return (int.from_bytes(pixels, "big") ^ noise).to_bytes(len(pixels), "big"), shown


def balls(
    plan: world.Plan, pose: tuple[float, float, float], focal: float
) -> list[tuple[float, float, float]]:
    """Depth, column and radius in pixels of every ball before the camera."""
    x, y, angle = pose
    found = []
    for ball_x, ball_y in plan.objects:
        ahead = (ball_x - x) * math.cos(angle) + (ball_y - y) * math.sin(angle)
        left = (ball_y - y) * math.cos(angle) - (ball_x - x) * math.sin(angle)
        if ahead > 0.4:
            found.append((ahead, COLUMNS / 2 - focal * left / ahead, focal * BALL_RADIUS / ahead))
    return found


def paint(pixels: bytearray, depths: list[float], ball: tuple[float, float, float]) -> bool:
    """Paint one ball where no wall hides it; whether it is whole, in sight and more than a speck."""
    depth, middle, radius = ball
    whole = radius >= 3 and radius <= middle <= COLUMNS - radius
    for column in range(max(0, math.ceil(middle - radius)), min(COLUMNS, int(middle + radius) + 1)):
        if depths[column // STRIPE] < depth - BALL_RADIUS:
            whole = False
            continue
        half = int(math.sqrt(max(0.0, radius * radius - (column - middle) ** 2)))
        for row in range(max(0, ROWS // 2 - half), min(ROWS, ROWS // 2 + half + 1)):
            pixels[row * COLUMNS + column] = BALL
    return whole


def take_data(robot: Robot, what: str, reply: dict[str, object], now: float) -> bytes:
    """A camera image or the ranges of the laser, with a number."""
    reply["number"] = robot.senses[what].take(now)
    if what == "scan":
        return robot.scan()
    body, reply["balls"] = robot.frame()
    reply["size"] = [COLUMNS, ROWS]
    return body


def note_result(robot: Robot, request: dict[str, object], reply: dict[str, object], now: float) -> float:
    """Take in a result, and reply how old its data is; how long the sense had none while its task moved."""
    sense = robot.senses[str(request["of"])]
    age, gap = sense.note(int(str(request["number"])), str(request["who"]), now)
    tell(robot.pipes.get(str(request["of"]), ""))
    reply["age_ms"] = 1000 * age
    return gap


def answer(robot: Robot, request: dict[str, object], payload: bytes) -> tuple[dict[str, object], bytes]:
    """The robot's reply to one request."""
    what, body, now, gap = request.get("ask"), b"", time.monotonic(), 0.0
    with robot.lock:
        robot.move(now)
        reply: dict[str, object] = {"over": robot.over, "pose": robot.believed()}
        if what in robot.senses:
            body = take_data(robot, str(what), reply, now)
        elif what == "result":
            gap = note_result(robot, request, reply, now)
        elif what == "drive":
            robot.forward, robot.turn, robot.told = (
                float(request["forward"]),
                float(request["turn"]),
                robot.moved,
            )  # type: ignore[arg-type]
        elif what == "tour":
            reply["tour"] = robot.tour
        elif what == "put":
            robot.board[str(request["name"])] = payload
        elif what == "get":
            body = robot.board.get(str(request["name"]), b"")
        elif what == "over":
            robot.over = reply["over"] = True
        reply["taken"] = {name: sense.results for name, sense in robot.senses.items()}
    if gap:
        wire.report(gap_ms=1000 * gap)
    return reply, body


def tell(pipe: str) -> None:
    """Wake whoever reads the pipe; mostly nobody does."""
    with contextlib.suppress(OSError):
        end = os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)
        try:
            os.write(end, b"\n")
        finally:
            os.close(end)


def make_pipes(robot: Robot, name: str, folder: Path) -> None:
    """A pipe for each sense of the robot of this name."""
    folder.mkdir(parents=True, exist_ok=True)
    for sense in robot.senses:
        robot.pipes[sense] = str(folder / f"{sense}-{name}")
        with contextlib.suppress(FileExistsError):
            os.mkfifo(robot.pipes[sense], 0o600)


class Server(socketserver.ThreadingTCPServer):
    """One thread per client."""

    allow_reuse_address = True
    daemon_threads = True
    robot: Robot


class Session(socketserver.StreamRequestHandler):
    """One client, until it leaves."""

    wbufsize = -1
    disable_nagle_algorithm = True
    server: Server

    def handle(self) -> None:
        """Answer what is asked."""
        try:
            while True:
                request, payload = wire.receive(self.rfile)
                wire.send(self.wfile, *answer(self.server.robot, request, payload))
        except OSError:
            return


def main() -> int:
    """Serve until TERM."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="ask whether it serves")
    args = parser.parse_args()
    if args.check:
        wire.own_robot().ask("pose")
        return 0
    name = os.environ.get("EDGECTL_ROBOT", "robot1")
    number = max(1, wire.port(name) - wire.PORT)
    address = (os.environ.get("EDGECTL_ROBOT_HOST") or "127.0.0.1", wire.port(name))
    with Server(address, Session) as server:
        server.robot = Robot(number)
        make_pipes(server.robot, name, Path.home() / "edgectl-patrol")
        sys.stdout.write("{} serves at {}:{}\n".format(name, *address))
        sys.stdout.flush()
        server.serve_forever()
    return 0


if __name__ == "__main__":
    sys.exit(main())
