"""Occupancy grids: log odds of each cell, updated by laser beams; and the merging of grids.

Python >= 3.8, standard library only.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Sequence

from world import FREE, HEIGHT, OCCUPIED, RESOLUTION, UNKNOWN, WIDTH

HIT, MISS, SUREST = 9, -3, 100
OCCUPIED_FROM, FREE_FROM = 8, -2
SHIFTS, TURNS = (-1, 0, 1), (-0.01, 0.0, 0.01)


def empty() -> array[int]:
    """A grid of which nothing is known; cells row by row from below."""
    return array("b", bytes(WIDTH * HEIGHT))


def line(x0: int, y0: int, x1: int, y1: int) -> list[int]:
    """The cells from one (column, row) to another without the last, by Bresenham's algorithm."""
    wide, tall = abs(x1 - x0), abs(y1 - y0)
    step_x, step_y = (1 if x1 > x0 else -1), (WIDTH if y1 > y0 else -WIDTH)
    cell, slip, found = y0 * WIDTH + x0, wide - tall, []
    for _ in range(wide + tall):
        if wide == 0 and tall == 0:
            break
        found.append(cell)
        twice = 2 * slip
        if twice > -tall:
            slip, cell, x0 = slip - tall, cell + step_x, x0 + (1 if step_x > 0 else -1)
        if twice < wide:
            slip, cell, y0 = slip + wide, cell + step_y, y0 + (1 if step_y > 0 else -1)
        if x0 == x1 and y0 == y1:
            break
    return found


def ends(pose: Sequence[float], scan: Sequence[int], reach: float) -> list[tuple[float, float, bool]]:
    """Where each beam ends (x, y), and whether it hit something there.

    ``scan`` in mm all around, 0 for nothing within reach.
    """
    x, y, angle = pose
    turn = 2 * math.pi / len(scan)
    found = []
    for beam, distance in enumerate(scan):
        # What is hit begins at the border of its cell; half a cell further is in it.
        far = distance / 1000 + RESOLUTION / 2 if distance else reach
        found.append(
            (x + far * math.cos(angle + beam * turn), y + far * math.sin(angle + beam * turn), distance > 0)
        )
    return found


def fit(cells: array[int], pose: Sequence[float], scan: Sequence[int]) -> tuple[float, float, float]:
    """The pose near the given one from which the beams best hit what is known: the middle of the best, among
    one step to each side.
    """
    best = (0, 0.0, (pose[0], pose[1], pose[2]))
    for turn in TURNS:
        hits = [
            (x / RESOLUTION, y / RESOLUTION)
            for x, y, hit in ends((pose[0], pose[1], pose[2] + turn), scan, 0.0)
            if hit
        ]
        for right in SHIFTS:
            for up in SHIFTS:
                moved = (pose[0] + right * RESOLUTION / 2, pose[1] + up * RESOLUTION / 2, pose[2] + turn)
                score = sum(
                    cells[int(y + up / 2) * WIDTH + int(x + right / 2)]
                    for x, y in hits
                    if 1 <= x < WIDTH - 1 and 1 <= y < HEIGHT - 1
                )
                best = max(best, (score, -abs(turn) - abs(right) - abs(up), moved))
    return best[2]


def learn(cells: array[int], pose: Sequence[float], scan: Sequence[int], reach: float) -> None:
    """Take in one scan: what beams pass is rather free, what they hit rather occupied."""
    column, row = int(pose[0] / RESOLUTION), int(pose[1] / RESOLUTION)
    passed: set[int] = set()
    struck: set[int] = set()
    for x, y, hit in ends(pose, scan, reach):
        to_column, to_row = (
            min(WIDTH - 1, max(0, int(x / RESOLUTION))),
            min(HEIGHT - 1, max(0, int(y / RESOLUTION))),
        )
        passed.update(line(column, row, to_column, to_row))
        if hit:
            struck.add(to_row * WIDTH + to_column)
    change(cells, passed - struck, MISS)
    change(cells, struck, HIT)


def change(cells: array[int], which: Iterable[int], amount: int) -> None:
    """Add to the log odds of some cells, never beyond the surest."""
    for cell in which:
        cells[cell] = max(-SUREST, min(SUREST, cells[cell] + amount))


def merged(grids: Sequence[array[int]]) -> array[int]:
    """One grid of all: the log odds of independent observations add up."""
    return array("b", (max(-SUREST, min(SUREST, sum(column))) for column in zip(*grids)))


def picture(cells: array[int]) -> bytes:
    """What map_server writes for each cell."""
    return bytes(
        OCCUPIED if cell >= OCCUPIED_FROM else FREE if cell <= FREE_FROM else UNKNOWN for cell in cells
    )
