"""Soak test: resources of a long watch must not grow."""
