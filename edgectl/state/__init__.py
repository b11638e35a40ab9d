"""State of the manager on disk: lock, journal, manager state, history; XDG paths."""
