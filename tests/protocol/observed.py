# SPDX-License-Identifier: Apache-2.0
"""Faults on real hosts, of which what was seen is checked against the model: `make model`, and a short form in the suite."""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.faults.fault_list import list_faults
from tests.faults.fleet import FLEET, EdgectlVariant, open_fleet
from tests.faults.oracle import list_lifetimes
from tests.faults.registry import Fault, draw_names
from tests.protocol.recorder import Event, Recorder, format_observed
from tests.protocol.tlc import MODEL, Bounds, Verdict, check_model, format_config

# Their tasks neither die nor change, so everything that is seen is the doing of a manager.
NAMES = ("two managers that disagree", "two managers with etcd")


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What was seen of one fault, in the words of the model."""

    fault: str
    seed: int
    looks: list[frozenset[Event]]
    gaps: list[str]

    @property
    def uses_etcd(self) -> bool:
        return any(event.revision for look in self.looks for event in look)

    def count(self, kind: str) -> int:
        return sum(event.kind == kind for look in self.looks for event in look)


def list_observable_faults(kind: str = "loopback") -> list[Fault]:
    """The faults of two managers that share a fleet."""
    return [each for each in list_faults() if each.name.startswith(NAMES) and kind in each.kinds]


def observe_fault(each: Fault, seed: int, *, sample: bool, kind: str = "loopback") -> Observation:
    """Inject the fault once into hosts of this kind, and look at them meanwhile."""
    variant = EdgectlVariant(sample=sample)
    with (
        tempfile.TemporaryDirectory(prefix="edgectl-model-") as directory,
        open_fleet(kind, Path(directory), draw_names(seed, variant), seed, variant) as fleet,
        Recorder(homes={name: host.home for name, host in fleet.hosts.items()}, fleet=FLEET) as recorder,
    ):
        each.inject(fleet)
        recorder.end()
        unseen = {life.cookie for life in list_lifetimes(fleet.records)} - recorder.instances
    gaps = recorder.gaps + [f"an instance that no look saw: {instance}" for instance in sorted(unseen)]
    return Observation(fault=each.name, seed=seed, looks=recorder.looks, gaps=gaps)


def check_observation(seen: Observation, directory: Path, *, memory: str = "1g") -> tuple[bool, Verdict]:
    """Whether the model behaves so, too: some order of what was seen, with steps between that nobody could see."""
    text, counts = format_observed(seen.looks)
    observed = directory / "source"
    observed.mkdir()
    (observed / "Observed.tla").write_text(text)
    bounds = Bounds(
        managers=counts["managers"],
        hosts=counts["hosts"],
        tasks=counts["tasks"],
        runs=counts["runs"],
        reboots=0,
        uses_etcd=seen.uses_etcd,
        has_common_host=False,
    )
    config = format_config(bounds, specification="TraceSpec", symmetry=False, invariants=("NotAccepted",))
    config += "CONSTANTS\n" + "".join(f"  {name} = {name}\n" for name in list_names(counts))
    run = directory / "run"
    run.mkdir()
    trace = MODEL.with_name("FleetTrace.tla")
    verdict = check_model(run, config, observed / "Observed.tla", trace, memory=memory)
    return verdict.violated == "NotAccepted", verdict


def list_names(counts: dict[str, int]) -> Iterator[str]:
    for letter, of in (("m", "managers"), ("h", "hosts"), ("t", "tasks")):
        yield from (f"{letter}{number + 1}" for number in range(counts[of]))
