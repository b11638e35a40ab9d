"""Resident profiler of a host: control, sampling, reading."""
