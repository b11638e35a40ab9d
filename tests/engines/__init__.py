# SPDX-License-Identifier: Apache-2.0
"""Sweeps on the real engines: ``make engines``."""
