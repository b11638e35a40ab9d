# SPDX-License-Identifier: Apache-2.0
"""All interleavings of two managers: ``python -m tests.simulation --count 10000 --seed 1``."""

import argparse

from tests.simulation.split_managers import SplitSimulation
from tests.simulation.two_managers import Simulation, run_simulations

KINDS = {"of two managers": Simulation, "on split networks": SplitSimulation}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.simulation", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="interleavings of each kind")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name, simulation in KINDS.items():
        changes = run_simulations(simulation, options.seed * 1_000_000, options.count)
        print(f"{options.count} interleavings {name}, {changes} changes on hosts, nothing doubled")


if __name__ == "__main__":
    main()
