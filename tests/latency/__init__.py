# SPDX-License-Identifier: Apache-2.0
"""Predicted latency against measured latency, on hosts with shaped links and real work (make latency)."""
