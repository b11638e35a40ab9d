"""The command line: load, use case, view, exit code."""
