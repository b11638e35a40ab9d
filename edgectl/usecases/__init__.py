"""One module per command: wiring of ports, without rules of its own."""
