# SPDX-License-Identifier: Apache-2.0
"""The solver behind ``plan --optimal``. Needs the extra opt, so nothing imports this room at start."""
