"""Data types of experiments, scenarios, replays and maps."""
