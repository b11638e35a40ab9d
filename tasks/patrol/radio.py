"""Bring robots near an edge: their links to it carry much, those to the other edges a tenth.

    python3 radio.py robot1=edge2 ..

$EDGECTL_PATROL_RADIO names a file with the classes of tc by robot and edge, as JSON:
{"robot1": {"edge2": [["DEVICE", "CLASS"], ..]}}. Without it nothing is shaped, as on one machine. Put your
own attenuator or access point here. Python >= 3.8, standard library only.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

NEAR, FAR = "16mbit", "1.6mbit"


def shape(classes: dict[str, dict[str, list[list[str]]]], robot: str, near: str) -> None:
    """Let the links of one robot carry what they do near this edge."""
    for edge, places in classes[robot].items():
        rate = NEAR if edge == near else FAR
        for device, name in places:
            words = ["class", "change", "dev", device, "parent", "1:", "classid", name, "htb"]
            subprocess.run(["tc", *words, "rate", rate, "burst", "16k"], check=True, timeout=10)


def main() -> int:
    """Shape what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("near", nargs="+", help="ROBOT=EDGE")
    pairs = [each.partition("=") for each in parser.parse_args().near]
    known = os.environ.get("EDGECTL_PATROL_RADIO")
    if not known:
        sys.stdout.write("no links to shape here\n")
        return 0
    classes = json.loads(Path(known).read_text())
    for robot, _, edge in pairs:
        shape(classes, robot, edge)
    return 0


if __name__ == "__main__":
    sys.exit(main())
