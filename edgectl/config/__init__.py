"""YAML and JSON text to model; every error has file, line, column, the line, a caret and a hint."""
