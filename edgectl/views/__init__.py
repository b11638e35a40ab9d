"""Values to text, one module per form."""
