"""One module per verb: wires ports, owns no rules."""
