# SPDX-License-Identifier: Apache-2.0
"""Experiments: simulate missions, replay snapshots, compare schemes on real hosts, score maps.

All of them use the real scheduler. The rest of edgectl does not import this package, except for its commands.
"""
