# SPDX-License-Identifier: Apache-2.0
"""A simulation of every item by small steps of time, to hold the flows of the model against. It shares nothing with them."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

STEP_S = 0.001


@dataclass(slots=True)
class Program:
    """At most ``rate`` items/s, each of which needs (place, work) one after the other."""

    rate: float
    work: Sequence[tuple[str, float]]
    at: int = -1
    left: float = 0.0
    due: float = 0.0
    began: float = 0.0
    ages: list[float] = field(default_factory=list)


def simulate_items(
    hosts: Mapping[str, tuple[float, int]],
    links: Mapping[str, float],
    programs: Sequence[Program],
    *,
    seconds: float,
    period: float = 0.1,
    machine_cores: int = 2,
) -> list[tuple[float, float]]:
    """Items/s and mean age (s) of each program.

    ``hosts``: cores, and processes of others that compute all the time. What a host has of CPU in a ``period`` is there at
    its begin; programs run at full speed until it is used up, no more than ``machine_cores`` at once.
    """
    draw = random.Random(7)
    for program in programs:
        program.due = draw.random() / program.rate
    quota = dict.fromkeys(hosts, 0.0)
    steps, per_period = round(seconds / STEP_S), round(period / STEP_S)
    for step in range(steps):
        now = step * STEP_S
        if step % per_period == 0:
            quota = {name: cores * period for name, (cores, _) in hosts.items()}
        for program in programs:
            if program.at < 0 and now >= program.due:
                program.at, program.left, program.began = 0, program.work[0][1], now
        _serve(hosts, links, programs, quota, machine_cores)
        for program in programs:
            _advance(program, now)
    return [
        (len(program.ages) / seconds, sum(program.ages) / max(1, len(program.ages))) for program in programs
    ]


def _serve(
    hosts: Mapping[str, tuple[float, int]],
    links: Mapping[str, float],
    programs: Sequence[Program],
    quota: dict[str, float],
    machine_cores: int,
) -> None:
    """One step of time for all that is there."""
    present: dict[str, list[Program]] = {name: [] for name in hosts}
    for program in programs:
        if program.at >= 0:
            present.setdefault(program.work[program.at][0], []).append(program)
    for name, there in present.items():
        if name in links:
            for program in there:
                program.left -= links[name] / len(there) * STEP_S
        elif (running := len(there) + hosts[name][1]) and quota[name] > 0:
            speed = min(1.0, machine_cores / running)
            quota[name] -= speed * running * STEP_S
            for program in there:
                program.left -= speed * STEP_S


def _advance(program: Program, now: float) -> None:
    """Go on to the next place, or wait until the next item is due; whoever is late does not catch up."""
    if program.at < 0 or program.left > 0:
        return
    program.at += 1
    if program.at < len(program.work):
        program.left = program.work[program.at][1]
        return
    program.at = -1
    program.ages.append(now - program.began)
    program.due = max(program.due + 1 / program.rate, now)
