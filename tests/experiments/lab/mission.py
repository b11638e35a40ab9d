# SPDX-License-Identifier: Apache-2.0
"""The programs of the mission as modules; hosts run them as they stand, so they are no package."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
MISSION = ROOT / "tasks" / "mission"
sys.path.insert(0, str(MISSION))

import detection  # noqa: E402
import follower  # noqa: E402
import grid  # noqa: E402
import mapper  # noqa: E402
import robot  # noqa: E402
import wire  # noqa: E402
import world  # noqa: E402

sys.path.remove(str(MISSION))

__all__ = ["MISSION", "ROOT", "detection", "follower", "grid", "mapper", "robot", "wire", "world"]
