"""Fan-out over all hosts into one immutable Snapshot."""
