"""A watch that runs for long: nothing of it may grow."""
