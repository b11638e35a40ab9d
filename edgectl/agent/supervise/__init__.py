"""Start, supervision, state and end of tasks."""
