# SPDX-License-Identifier: Apache-2.0
"""Runs of TLC, the model checker, on the model of docs/model."""

import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from tests.pace import patience

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "docs" / "model" / "Fleet.tla"
JAR = ROOT / ".venv" / "lib" / "tla2tools.jar"
INVARIANTS = ("NeverTwice", "OneWriter", "NothingUnseen")


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Constants of the model: how much there is of everything, and which rules hold."""

    managers: int = 2
    hosts: int = 2
    tasks: int = 1
    runs: int = 3
    reboots: int = 1
    uses_etcd: bool = False
    has_common_host: bool = True
    checks_lease: bool = True
    holds_unseen: bool = True
    books_first: bool = True
    proves_stop: bool = True
    waits_after_boot: bool = True

    def format(self) -> str:
        """Only what differs from the usual."""
        usual = Bounds()
        said = [
            f"{each.name}={value}"
            for each in fields(self)
            if (value := getattr(self, each.name)) != getattr(usual, each.name)
        ]
        return " ".join(said) or "usual"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """``violated``: the invariant that does not hold, empty where all do; ``states``: distinct ones that were found."""

    violated: str
    states: int
    text: str


def format_config(
    bounds: Bounds,
    *,
    specification: str = "Spec",
    symmetry: bool = True,
    invariants: Sequence[str] = INVARIANTS,
) -> str:
    """The configuration of one run."""
    hosts = name_values("h", bounds.hosts)
    common = hosts[0] if bounds.has_common_host and not bounds.uses_etcd else "None"
    constants = {
        "Managers": _format_set(name_values("m", bounds.managers)),
        "Hosts": _format_set(hosts),
        "Tasks": _format_set(name_values("t", bounds.tasks)),
        "None": "None",
        "Common": common,
        "UsesEtcd": bounds.uses_etcd,
        "ChecksLease": bounds.checks_lease,
        "HoldsUnseen": bounds.holds_unseen,
        "BooksFirst": bounds.books_first,
        "ProvesStop": bounds.proves_stop,
        "WaitsAfterBoot": bounds.waits_after_boot,
        "MaxRuns": bounds.runs,
        "MaxReboots": bounds.reboots,
    }
    lines = [f"SPECIFICATION {specification}", "CONSTANTS"]
    lines += [
        f"  {name} = {str(value).upper() if isinstance(value, bool) else value}"
        for name, value in constants.items()
    ]
    lines += [f"INVARIANTS {' '.join(invariants)}"]
    return "\n".join([*lines, *(["SYMMETRY Alike"] if symmetry else [])]) + "\n"


def name_values(letter: str, count: int) -> list[str]:
    return [f"{letter}{number + 1}" for number in range(count)]


def _format_set(names: Sequence[str]) -> str:
    return "{" + ", ".join(names) + "}"


def check_model(
    directory: Path,
    config: str,
    *modules: Path,
    whole: bool = False,
    memory: str = "1g",
    timeout_s: float = 300.0,
) -> Verdict:
    """Check the last of ``modules``, or the model itself, in all states; in ``directory``, which must be empty.

    ``whole``: for long checks, on both cores. A short one spends most of its time on compiling Java, so it is
    compiled less.
    """
    assert JAR.exists(), "the tests need TLC: .ci/need-tlc"
    assert shutil.which("java"), "the tests need Java: .ci/need-tlc"
    for module in (MODEL, *modules):
        shutil.copy(module, directory)
    main = (MODEL, *modules)[-1].name
    (directory / "Check.cfg").write_text(config)
    java = ["java", "-XX:+UseSerialGC", f"-Xmx{memory}", "-cp", str(JAR)]
    if not whole:
        java += ["-XX:TieredStopAtLevel=1"]
    options = ["-workers", str(2 if whole else 1), "-deadlock", "-metadir", "states", "-config", "Check.cfg"]
    done = subprocess.run(
        [*java, "tlc2.TLC", *options, main],
        cwd=directory, capture_output=True, text=True, check=False, timeout=patience(timeout_s),
    )  # fmt: skip
    return read_verdict(done.stdout + done.stderr)


def read_verdict(text: str) -> Verdict:
    """What TLC says at the end.

    Raises:
        AssertionError: it did not come to an end.
    """
    violated = re.search(r"Invariant (\w+) is violated", text)
    found = re.findall(r"(\d+) distinct states found", text)
    assert violated or "No error has been found" in text, text[-3000:]
    return Verdict(violated=violated[1] if violated else "", states=int(found[-1]) if found else 0, text=text)
