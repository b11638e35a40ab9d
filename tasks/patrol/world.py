"""The world of the patrol: a small floor plan in three areas, its obstacles, the tours of the robots, and ray
casting for their lasers.

    python3 world.py DIRECTORY        writes world.pgm and world.yaml, as map_server does: the true map

The plan is drawn from a seed, the same on every machine. Lengths in metres, angles in radians, the origin at
the lower left. Python >= 3.8, standard library only.
"""

from __future__ import annotations

import math
import random
import sys
from pathlib import Path

SEED = 7
RESOLUTION = 0.05
WIDTH, HEIGHT = 160, 120
FREE, UNKNOWN, OCCUPIED = 254, 205, 0
WALL = 2
CORRIDOR = (50, 70)
DOOR = 18
ROOMS = 3


class Plan:
    """``solid``: one byte per cell, row by row from below, 1 where nothing can be.

    ``objects``: what a camera should find (x, y).
    """

    def __init__(self, seed: int = SEED) -> None:
        draw = random.Random(seed)
        self.solid = bytearray(WIDTH * HEIGHT)
        self.objects: list[tuple[float, float]] = []
        self._outer_walls()
        columns = [
            0,
            *(int(WIDTH * number / ROOMS + 8 * (draw.random() - 0.5)) for number in range(1, ROOMS)),
            WIDTH,
        ]
        rooms = [(left, right, above) for left, right in zip(columns, columns[1:]) for above in (True, False)]
        self.stops = [self._room(room, draw) for room in rooms]

    def _outer_walls(self) -> None:
        for left, bottom, right, top in (
            (0, 0, WIDTH, WALL),
            (0, HEIGHT - WALL, WIDTH, HEIGHT),
            (0, 0, WALL, HEIGHT),
            (WIDTH - WALL, 0, WIDTH, HEIGHT),
        ):
            self._fill(left, bottom, right, top)

    def _fill(self, left: int, bottom: int, right: int, top: int, what: int = 1) -> None:
        for row in range(bottom, top):
            self.solid[row * WIDTH + left : row * WIDTH + right] = bytes([what]) * (right - left)

    def _room(self, room: tuple[int, int, bool], draw: random.Random) -> list[tuple[float, float]]:
        """Build one room; where a robot stops for it: before its door, and in its middle."""
        left, right, above = room
        bottom, top = (CORRIDOR[1], HEIGHT) if above else (0, CORRIDOR[0])
        wall = bottom if above else top - WALL
        self._fill(left, wall, right, wall + WALL)
        if right < WIDTH:
            self._fill(right - WALL, bottom, right, top)
        door = (left + right) // 2 + int(10 * (draw.random() - 0.5))
        self._fill(door - DOOR // 2, wall, door + DOOR // 2, wall + WALL, 0)
        width, depth = 7 + int(6 * draw.random()), 6 + int(6 * draw.random())
        far = top - WALL - depth if above else bottom + WALL
        corner = left or WALL
        self._fill(corner, far, corner + width, far + depth)
        for across in (0.3, 0.75):
            height = (top - 8 if above else bottom + 8) + int(4 * (draw.random() - 0.5))
            self.objects.append((metres(left + across * (right - left) + 2), metres(height)))
        middle = (bottom + top) / 2
        return [(metres(door), metres(sum(CORRIDOR) / 2)), (metres(door), metres(middle))]

    def tour(self, robot: int) -> list[tuple[float, float]]:
        """Where robot number ``robot`` (from 1) stops: in a room of each area, through its door and back out.

        Each robot begins in another area, with the room below the corridor; then it takes those above. Three
        robots see all rooms.
        """
        found = []
        for visit in range(ROOMS):
            door, middle = self.stops[2 * ((robot - 1 + visit) % ROOMS) + (visit == 0)]
            found += [door, middle, door]
        return found

    def free(self, x: float, y: float) -> bool:
        """Whether nothing stands there."""
        column, row = int(x / RESOLUTION), int(y / RESOLUTION)
        return 0 <= column < WIDTH and 0 <= row < HEIGHT and not self.solid[row * WIDTH + column]


def metres(cells: float) -> float:
    """A length in metres."""
    return cells * RESOLUTION


def cast(solid: bytes | bytearray, x: float, y: float, angle: float, reach: float) -> float:
    """How far it is from (x, y) to what is solid in that direction, at most ``reach``.

    Walks from cell to cell, and skips none.
    """
    ahead, up = math.cos(angle), math.sin(angle)
    column, row = int(x / RESOLUTION), int(y / RESOLUTION)
    step_x, step_y = (1 if ahead > 0 else -1), (WIDTH if up > 0 else -WIDTH)
    pace_x = abs(RESOLUTION / ahead) if ahead else math.inf
    pace_y = abs(RESOLUTION / up) if up else math.inf
    next_x = ((column + (ahead > 0)) * RESOLUTION - x) / ahead if ahead else math.inf
    next_y = ((row + (up > 0)) * RESOLUTION - y) / up if up else math.inf
    cell, far = row * WIDTH + column, 0.0
    while far < reach:
        if solid[cell]:
            return far
        if next_x < next_y:
            cell, far, next_x = cell + step_x, next_x, next_x + pace_x
        else:
            cell, far, next_y = cell + step_y, next_y, next_y + pace_y
    return reach


def seen(plan: Plan) -> bytes:
    """What a perfect mapper could know: free where a robot could get to, occupied where that touches
    something, unknown elsewhere.
    """
    picture = bytearray([UNKNOWN]) * (WIDTH * HEIGHT)
    x, y = plan.stops[0][0]
    todo = [int(y / RESOLUTION) * WIDTH + int(x / RESOLUTION)]
    picture[todo[0]] = FREE
    while todo:
        cell = todo.pop()
        for other in (cell - 1, cell + 1, cell - WIDTH, cell + WIDTH):
            if picture[other] == UNKNOWN:
                picture[other] = OCCUPIED if plan.solid[other] else FREE
                if picture[other] == FREE:
                    todo.append(other)
    return bytes(picture)


def write_map(directory: Path, name: str, cells: bytes) -> None:
    """Write NAME.pgm and NAME.yaml in the form of map_server; ``cells`` row by row from below."""
    directory.mkdir(parents=True, exist_ok=True)
    rows = [cells[row * WIDTH : (row + 1) * WIDTH] for row in reversed(range(HEIGHT))]
    (directory / (name + ".pgm")).write_bytes(b"P5\n%d %d\n255\n" % (WIDTH, HEIGHT) + b"".join(rows))
    lines = [
        f"image: {name}.pgm",
        f"resolution: {RESOLUTION}",
        "origin: [0.0, 0.0, 0.0]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.196",
    ]
    (directory / (name + ".yaml")).write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    write_map(Path(sys.argv[1] if len(sys.argv) > 1 else "."), "world", seen(Plan()))
