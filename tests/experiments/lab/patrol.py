# SPDX-License-Identifier: Apache-2.0
"""The programs of the patrol as modules; hosts run them as they stand, so they are no package."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
PATROL = ROOT / "tasks" / "patrol"
sys.path.insert(0, str(PATROL))

import detection  # noqa: E402
import follower  # noqa: E402
import grid  # noqa: E402
import mapper  # noqa: E402
import radio  # noqa: E402
import robot  # noqa: E402
import wire  # noqa: E402
import world  # noqa: E402

sys.path.remove(str(PATROL))

__all__ = ["PATROL", "ROOT", "detection", "follower", "grid", "mapper", "radio", "robot", "wire", "world"]
