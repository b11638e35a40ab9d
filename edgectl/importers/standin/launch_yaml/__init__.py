# SPDX-License-Identifier: Apache-2.0
"""Stand-in of the package launch_yaml."""
