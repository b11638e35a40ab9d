"""HTML page and figures of an experiment."""
