"""The report of an experiment: page and figures."""
