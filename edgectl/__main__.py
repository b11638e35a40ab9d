# SPDX-License-Identifier: Apache-2.0
"""``python -m edgectl``: the same command."""

import sys

from edgectl.cli.main import main

sys.exit(main())
