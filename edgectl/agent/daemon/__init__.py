# SPDX-License-Identifier: Apache-2.0
"""Resident profiler of a host: control, sampling, reading."""
