"""One class per output of an experiment command: table, wide table, Markdown, document."""
