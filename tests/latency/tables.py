# SPDX-License-Identifier: Apache-2.0
"""Tables of predicted and measured latency: placements under loads, and misses with and without deadlines."""

import dataclasses
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from statistics import median

from edgectl.config.weights import parse_weights
from edgectl.model.policy import Policy
from edgectl.model.predicted_latency import PredictedLatency, ServiceTime
from tests.latency.bench import (
    Bench,
    Frame,
    Link,
    Measured,
    Site,
    build_task,
    compute_service,
    decide,
    measure_service,
)

FRAMES = (Frame(width=176, height=132), Frame(width=240, height=180))
LINKS = (Link(rate=100e6), Link(rate=30e6), Link(rate=10e6))
LOADS = (0.0, 0.2, 0.4, 0.5, 0.6)
FAST, SLOW = Link(rate=100e6), Link(rate=10e6)
# Of the scenario with deadlines: frames a second, and what a deadline leaves besides the service time.
PERIOD_S, SPARE_S = 0.25, 0.033
THINK_S = 0.06


@dataclass(frozen=True, kw_only=True)
class Row:
    """One placement under one load."""

    frame: Frame
    link: Link
    load: float
    predicted: PredictedLatency
    measured: Measured

    def compute_error(self, share: float) -> float:
        """Predicted minus measured, as a share of what was measured."""
        return self.predict_ms(share) / self.measured.percentile_ms(share) - 1.0

    def predict_ms(self, share: float) -> float:
        forms = {0.50: self.predicted.p50_ms, 0.95: self.predicted.p95_ms, 0.99: self.predicted.p99_ms}
        return forms[share]

    def is_surely_within(self, share: float, bar: float) -> bool:
        """Whether the error is within ``bar`` at both ends of the interval of what was measured."""
        predicted = self.predict_ms(share)
        return all(abs(predicted / end - 1.0) <= bar for end in self.measured.bound_percentile_ms(share))

    @property
    def coverage(self) -> float:
        """The share of jobs inside the predicted interval."""
        low, high = self.predicted.low_ms, self.predicted.high_ms
        return sum(low <= 1000.0 * each <= high for each in self.measured.latencies) / len(
            self.measured.latencies
        )

    def format(self) -> str:
        cells = [f"{self.frame.width} x {self.frame.height}", f"{self.link.rate / 1e6:.0f}"]
        cells += [f"{self.measured.used:.2f}", f"{self.measured.foreign:.2f}"]
        for share, value in ((0.50, self.predicted.p50_ms), (0.99, self.predicted.p99_ms)):
            measured = self.measured.percentile_ms(share)
            cells.append(f"{value:.0f} / {measured:.0f} ({self.compute_error(share):+.0%})")
        return f"| {' | '.join([*cells, f'{self.coverage:.0%}'])} |"


def measure_rows(
    bench: Bench, *, jobs: int, cases: Sequence[tuple[Frame, Link, float]] | None = None
) -> Iterator[Row]:
    """Each placement under each load; service times are measured on the idle host, once for each placement."""
    every = [(frame, link, load) for frame in FRAMES for link in LINKS for load in LOADS]
    services: dict[tuple[Frame, Link], ServiceTime] = {}
    for frame, link, load in every if cases is None else cases:
        bench.shape(link)
        if (frame, link) not in services:
            services[frame, link] = measure_service(bench, frame, jobs=max(40, jobs))
        service = services[frame, link]
        measured = bench.measure(frame, load, service.p50, jobs=jobs, think=THINK_S)
        yield predict_row(frame, link, load, measured, service)


def predict_row(frame: Frame, link: Link, load: float, measured: Measured, service: ServiceTime) -> Row:
    """What a plan predicts for the load that was measured."""
    site = Site(link=link, used=measured.used, rtt_ms=measured.rtt_ms)
    _, predicted = decide(build_task(frame, service, 1.0, period=1.0), [site], Policy())
    return Row(frame=frame, link=link, load=load, predicted=predicted[0], measured=measured)


def format_record(row: Row) -> str:
    """One line of JSON with all jobs of a row, for `read_rows`."""
    size, measured = [row.frame.width, row.frame.height], dataclasses.asdict(row.measured)
    return json.dumps({"frame": size, "rate": row.link.rate, "load": row.load, **measured})


def read_rows(path: Path) -> Iterator[Row]:
    """Predict the rows of a file of records again.

    The service time of a row is that of the jobs without load of its frame in all other rows.
    """
    records = [json.loads(line) for line in path.read_text().splitlines()]
    for record in records:
        frame = Frame(width=record["frame"][0], height=record["frame"][1])
        idle = [
            services
            for other in records
            if other is not record and not other["load"] and other["frame"] == record["frame"]
            for services in other["services"]
        ]
        fields = {each.name: record[each.name] for each in dataclasses.fields(Measured)}
        service = compute_service(sorted(idle))
        yield predict_row(frame, Link(rate=record["rate"]), record["load"], Measured(**fields), service)


def print_rows(rows: Sequence[Row]) -> None:
    """The errors of all rows: median, and how many are within the bars."""
    for share, bar in ((0.50, 0.10), (0.95, 0.20), (0.99, 0.20)):
        errors = [abs(row.compute_error(share)) for row in rows]
        within = sum(error <= bar for error in errors)
        surely = sum(row.is_surely_within(share, bar) for row in rows)
        print(
            f"p{share * 100:.0f}: median error {median(errors):.1%}, largest {max(errors):.0%}; "
            f"within {bar:.0%}: {within} of {len(rows)}, {surely} wherever measured p{share * 100:.0f} may be (95 %)"
        )
    jobs = sum(len(row.measured.latencies) for row in rows)
    inside = sum(row.coverage * len(row.measured.latencies) for row in rows)
    print(
        f"jobs inside the interval: {inside / jobs:.0%}; least of a row {min(row.coverage for row in rows):.0%}"
    )


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One fleet of two edges: misses of its placement under preset all, and under preset latency, of ``jobs``."""

    links: tuple[Link, Link]
    loads: tuple[float, float]
    chosen: tuple[int, int]
    misses: tuple[int, int]
    jobs: int

    def format(self) -> str:
        cells = [" : ".join(f"{link.rate / 1e6:.0f}" for link in self.links)]
        cells += [" : ".join(f"{load:.2f}" for load in self.loads)]
        cells += [
            f"edge{edge + 1}: {misses} of {self.jobs}"
            for edge, misses in zip(self.chosen, self.misses, strict=True)
        ]
        return f"| {' | '.join(cells)} |"


def compare_presets(bench: Bench, *, jobs: int, seeds: Sequence[int]) -> Iterator[Comparison]:
    """edge1 is nearly idle, edge2 works; first edge1's link is ten times slower, then both are alike."""
    frame = FRAMES[1]
    for links in ((SLOW, FAST), (FAST, FAST)):
        for seed in seeds:
            random = Random(seed)
            loads = random.uniform(0.0, 0.08), random.uniform(0.18, 0.28)
            yield _compare(bench, frame, links, loads, jobs)


def _compare(
    bench: Bench, frame: Frame, links: tuple[Link, Link], loads: tuple[float, float], jobs: int
) -> Comparison:
    bench.shape(FAST)
    service = measure_service(bench, frame)
    deadline = service.p50 + SPARE_S
    task = build_task(frame, service, deadline, period=PERIOD_S)
    sites = [Site(link=link, used=load, rtt_ms=0.1) for link, load in zip(links, loads, strict=True)]
    chosen = tuple(decide(task, sites, Policy(weights=parse_weights(name)))[0] for name in ("all", "latency"))
    misses = {}
    for edge in sorted(set(chosen)):
        bench.shape(links[edge])
        found = bench.measure(frame, loads[edge], service.p50, jobs=jobs, think=PERIOD_S - service.p50)
        misses[edge] = found.count_misses(deadline)
    return Comparison(
        links=links,
        loads=loads,
        chosen=(chosen[0], chosen[1]),
        misses=(misses[chosen[0]], misses[chosen[1]]),
        jobs=jobs,
    )


def print_comparisons(found: Sequence[Comparison]) -> None:
    """The sums by kind of links."""
    for name, links in (("links 10:1", (SLOW, FAST)), ("links alike", (FAST, FAST))):
        of = [each for each in found if each.links == links]
        before, after = (sum(each.misses[index] for each in of) for index in (0, 1))
        ratio = f", {before / after:.1f} times fewer" if after else ""
        print(f"{name}: {before} misses with preset all, {after} with preset latency{ratio}")
