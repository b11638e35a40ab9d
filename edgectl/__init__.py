# SPDX-License-Identifier: Apache-2.0
"""edgectl: utility-based placement of robot tasks on edge computers, from a terminal, over SSH."""

__version__ = "0.1.0"
