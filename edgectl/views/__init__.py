"""Outputs: one class and one module for each thing that is shown."""
