"""Tables and documents of experiments."""
