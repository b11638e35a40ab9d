"""The manager's own files: lock, journal, memory; XDG paths."""
