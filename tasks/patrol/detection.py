"""Detect the bright balls in a robot's camera frames: blur, adaptive threshold, connected components,
roundness.

    python3 detection.py [--rate 5]

Metrics: ``fps`` frames per second, ``frame_ms`` from a frame's arrival to its result, ``age_ms`` of each
frame when the robot has its result, by the robot's clock, ``recall`` share of the visible balls that were
found. Ends with success when the robot reports the end of its mission. Python >= 3.8, standard library only.
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import accumulate

import wire

BLUR, AROUND, BRIGHTER = 1, 30, 40
LEAST, FULLEST, ROUNDEST = 12, 0.6, 1.6
EVERY_S = 1.0


def summed(rows: list[list[int]]) -> list[list[int]]:
    """The integral image: sums of everything above and left, with a row and a column of zeros."""
    table = [[0] * (len(rows[0]) + 1)]
    for row in rows:
        table.append([0, *map(int.__add__, accumulate(row), table[-1][1:])])
    return table


def averaged(rows: list[list[int]], reach: int) -> list[list[int]]:
    """The mean of the square of ``2 * reach + 1`` pixels around each pixel, smaller at the border."""
    table, height, width = summed(rows), len(rows), len(rows[0])
    left = [max(0, column - reach) for column in range(width)]
    right = [min(width, column + reach + 1) for column in range(width)]
    found = []
    for row in range(height):
        top, bottom = max(0, row - reach), min(height, row + reach + 1)
        above, below, tall = table[top], table[bottom], bottom - top
        found.append(
            [(below[b] - below[a] - above[b] + above[a]) // ((b - a) * tall) for a, b in zip(left, right)]
        )
    return found


def pieces(bright: list[list[bool]]) -> list[list[tuple[int, int]]]:
    """The pixels (row, column) of every connected piece."""
    left = {(row, column) for row, lits in enumerate(bright) for column, lit in enumerate(lits) if lit}
    found = []
    while left:
        todo, piece = [left.pop()], []
        while todo:
            row, column = todo.pop()
            piece.append((row, column))
            for other in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
                if other in left:
                    left.remove(other)
                    todo.append(other)
        found.append(piece)
    return found


def is_round(piece: list[tuple[int, int]]) -> bool:
    """Whether a piece is large enough, about as wide as high, and fills its box."""
    rows, columns = [row for row, _ in piece], [column for _, column in piece]
    tall, wide = max(rows) - min(rows) + 1, max(columns) - min(columns) + 1
    return (
        len(piece) >= LEAST
        and max(tall, wide) <= ROUNDEST * min(tall, wide)
        and len(piece) >= FULLEST * tall * wide
    )


def detect(pixels: bytes, width: int) -> list[tuple[float, float]]:
    """The middles (column, row) of the balls in a picture, from left to right."""
    rows = [list(pixels[at : at + width]) for at in range(0, len(pixels), width)]
    smooth = averaged(rows, BLUR)
    around = averaged(smooth, AROUND)
    bright = [[pixel > mean + BRIGHTER for pixel, mean in zip(*both)] for both in zip(smooth, around)]
    found = [piece for piece in pieces(bright) if is_round(piece)]
    return sorted(
        (sum(c for _, c in piece) / len(piece), sum(r for r, _ in piece) / len(piece)) for piece in found
    )


def watch(robot: wire.Link, rate: float) -> None:
    """Look at pictures until the mission is over."""
    pace = wire.Pace(rate)
    began, frames, busy, sought, found = time.monotonic(), 0, 0.0, 0, 0
    while True:
        header, pixels = robot.ask("frame")
        if header["over"]:
            return
        arrived = time.monotonic()
        seen = detect(pixels, header["size"][0])
        now = time.monotonic()
        wire.count(age_ms=wire.give_result(robot, "frame", header["number"]))
        frames, busy, sought, found = (
            frames + 1,
            busy + now - arrived,
            sought + header["balls"],
            found + min(len(seen), header["balls"]),
        )
        if now - began >= EVERY_S:
            wire.report(
                fps=frames / (now - began),
                frame_ms=1000 * busy / frames,
                recall=found / sought if sought else 1.0,
            )
            began, frames, busy = now, 0, 0.0
        pace.wait()


def main() -> int:
    """Run until the robot's mission is over."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=5.0, help="pictures per second at most")
    watch(wire.own_robot(), parser.parse_args().rate)
    return 0


if __name__ == "__main__":
    sys.exit(main())
