"""Commands of the Evaluate group."""
