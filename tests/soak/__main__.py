# SPDX-License-Identifier: Apache-2.0
"""Soak test: ``python -m tests.soak [CYCLES [CYCLES]]``, a long watch over simulated hosts, then one over
real sshd hosts. Fails on growth.
"""

import sys
import tempfile
from pathlib import Path

from tests.soak import simulated_hosts, ssh_hosts
from tests.soak.resource_readings import ResourceReading, format_table, list_growth


def main(simulated: int = 10_000, over_ssh: int = 200) -> int:
    """Return the exit status: 0, or 1 if something grew or was left behind."""
    wrong = []
    for name, (seconds, warm, end, counts), cycles in (
        ("simulated hosts", simulated_hosts.time_simulated_soak(simulated), simulated),
        ("real sshd", ssh_hosts.time_ssh_soak(over_ssh), over_ssh),
    ):
        print_report(name, cycles, seconds, warm, end, counts)
        wrong += [f"{name}: {each}" for each in list_growth(warm, end)]
        wrong += [f"{name}: {counts[key]} {key}" for key in ("errors", "left behind") if counts.get(key)]
    print("grew: " + "; ".join(wrong) if wrong else "nothing grew")
    return 1 if wrong else 0


def print_report(
    name: str,
    cycles: int,
    seconds: float,
    warm: ResourceReading,
    end: ResourceReading,
    counts: dict[str, int],
) -> None:
    print(format_table(name, cycles, seconds, warm, end))
    print(", ".join(f"{count} {what}" for what, count in counts.items()), "\n", flush=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(prefix="edgectl-soak-home-") as home:
        import os

        os.environ |= {
            "HOME": home,
            "XDG_STATE_HOME": str(Path(home) / "state"),
            "EDGECTL_STATE_DIR": str(Path(home) / "state"),
        }
        sys.exit(main(*map(int, sys.argv[1:3])))
