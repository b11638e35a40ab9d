# SPDX-License-Identifier: Apache-2.0
"""Data types of experiments, scenarios and comparisons."""
