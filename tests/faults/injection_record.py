# SPDX-License-Identifier: Apache-2.0
"""Record of injections in a file of JSON lines, by which a later run goes on: with the next seeds, and first with the
faults that were injected least often.
"""

import json
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from tests.faults.oracle import OracleVerdict
from tests.faults.registry import Fault, FaultRow, InjectionResult

Case = tuple[Fault, str, int]
"""A fault, the kind of its hosts, and how often it is to be injected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedInjection:
    """One injection on hosts of its own, which may have had several rounds. ``run``: the seed from which its own
    ``seed`` was drawn; ``wrong``: its failure, if any.
    """

    day: str
    fault: str
    kind: str
    run: int
    seed: int
    injected: int
    lost: int
    doubled: int
    seconds: float
    wrong: str


def read_records(path: Path) -> list[RecordedInjection]:
    """Read the file; a line that a killed run has left unfinished is no injection."""
    found = []
    for line in path.read_text().splitlines() if path.exists() else []:
        with suppress(ValueError):
            found.append(RecordedInjection(**json.loads(line)))
    return found


def add_record(
    path: Path, case: Case, run: int, seed: int, result: InjectionResult, *, seconds: float
) -> None:
    """Add an injection to the file."""
    verdict = result.wrong if isinstance(result.wrong, OracleVerdict) else OracleVerdict()
    found = RecordedInjection(
        day=datetime.now(UTC).date().isoformat(),
        fault=case[0].name,
        kind=case[1],
        run=run,
        seed=seed,
        injected=result.injected,
        lost=len(verdict.lost),
        doubled=len(verdict.doubled),
        seconds=round(seconds, 1),
        wrong=str(result.wrong),
    )
    with path.open("a") as file:
        file.write(json.dumps(asdict(found)) + "\n")


def count_seeds(records: Iterable[RecordedInjection], case: Case, run: int) -> int:
    """Count the seeds of ``run`` that the case has used up."""
    return sum((each.fault, each.kind, each.run) == (case[0].name, case[1], run) for each in records)


def order_cases(cases: list[Case], records: Iterable[RecordedInjection]) -> list[Case]:
    """Put the cases first that were injected least often; equals stay in the order of the table."""
    counts = Counter((each.fault, each.kind) for each in records)
    return sorted(cases, key=lambda case: counts[case[0].name, case[1]])


def build_rows(records: Iterable[RecordedInjection]) -> list[FaultRow]:
    """Build the rows of the table of everything in the file."""
    rows: dict[tuple[str, str], FaultRow] = {}
    for each in records:
        row = rows.setdefault((each.fault, each.kind), FaultRow(fault=each.fault, kind=each.kind))
        row.injected += each.injected
        row.survived += each.injected - bool(each.wrong)
        row.lost += each.lost
        row.doubled += each.doubled
        row.seconds += each.seconds
        if each.wrong:
            row.failures.append(f"{each.fault} ({each.kind}, seed {each.seed}): {each.wrong}")
    return list(rows.values())
