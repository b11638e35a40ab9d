# SPDX-License-Identifier: Apache-2.0
"""Stand-in of the package nav2_common."""
