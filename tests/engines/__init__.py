"""Sweeps on the real engines: ``make engines``."""
