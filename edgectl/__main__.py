# SPDX-License-Identifier: Apache-2.0
"""``python -m edgectl``: the same command."""

from edgectl.cli.main import run

run()
