# SPDX-License-Identifier: Apache-2.0
"""Sweeps: a mission under several schemes in many worlds, and the results of each world."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from edgectl.experiments.model.scenario import Scenario
from edgectl.experiments.model.schemes import Scheme
from edgectl.model.encoding import FromOne, Rounded, in_document
from edgectl.model.inventory import Inventory
from edgectl.model.task import Tasks

# A result is read back and printed again: the same digits everywhere.
SweepSeconds = Annotated[float, Rounded(decimals=3)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepBounds:
    """Runs of each scheme in a world: at most ``runs``, and fewer once one scheme is the fastest.

    ``error``: highest probability of naming a scheme the fastest that is not; None: all runs are made.
    """

    runs: int
    seed: int
    error: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepWorld:
    """One combination of settings, with everything that a simulation of it needs.

    ``settings``: as the file of the sweep writes them. ``digest``: of all else, 64 hex digits; worlds that
    only have other settings written, and not another meaning, have the same.
    """

    settings: Mapping[str, str]
    inventory: Inventory
    tasks: Tasks
    scenario: Scenario
    schemes: tuple[Scheme, ...]
    bounds: SweepBounds
    digest: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SchemeRuns:
    """The runs of one scheme, in the order of their seeds: mission times (s), moves, tasks without a place in
    a plan. ``unfinished``: runs that the limit ended.
    """

    latency: tuple[SweepSeconds, ...] = field(metadata=in_document("latency_s"))
    handoffs: tuple[int, ...]
    unplaced: tuple[int, ...]
    unfinished: int = field(default=0, metadata=in_document(always=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldResult:
    """The runs of all schemes in one world. ``winner``: the scheme that is the fastest with the stated
    error; "" where none is.
    """

    digest: str
    runs: FromOne
    schemes: Mapping[str, SchemeRuns]
    winner: str = field(default="", metadata=in_document(always=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """A sweep out of its file. ``axes``: the settings that vary, in the order of the file."""

    name: str
    axes: tuple[str, ...]
    worlds: tuple[SweepWorld, ...]
    bounds: SweepBounds
