"""Predicted latency against measured latency, on hosts with shaped links and real work (make latency)."""
