# SPDX-License-Identifier: Apache-2.0
"""Live view of ``edgectl top -i``. Needs the extra tui, so nothing imports this room at start."""

from edgectl.tui.run import run_top_view

__all__ = ["run_top_view"]
