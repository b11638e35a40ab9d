# SPDX-License-Identifier: Apache-2.0
"""Files of experiments: specifications, scenarios, maps and runs."""
