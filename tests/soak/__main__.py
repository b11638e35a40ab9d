"""``python -m tests.soak [CYCLES [CYCLES]]``: a long watch over simulated hosts, then one over real sshd hosts. Fails where anything grew."""

import sys
import tempfile
from pathlib import Path

from tests.soak import fake, real
from tests.soak.gauge import Reading, grown, table


def main(simulated: int = 10_000, over_ssh: int = 200) -> int:
    """Exit status: 0, or 1 where something grew or was left behind."""
    wrong = []
    for name, (seconds, warm, end, counts), cycles in (
        ("simulated hosts", fake.timed(simulated), simulated),
        ("real sshd", real.timed(over_ssh), over_ssh),
    ):
        report(name, cycles, seconds, warm, end, counts)
        wrong += [f"{name}: {each}" for each in grown(warm, end)]
        wrong += [f"{name}: {counts[key]} {key}" for key in ("errors", "left behind") if counts.get(key)]
    print("grew: " + "; ".join(wrong) if wrong else "nothing grew")
    return 1 if wrong else 0


def report(
    name: str, cycles: int, seconds: float, warm: Reading, end: Reading, counts: dict[str, int]
) -> None:
    print(table(name, cycles, seconds, warm, end))
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
