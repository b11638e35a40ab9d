"""Data types of experiments, scenarios and comparisons."""
