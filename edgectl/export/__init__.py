"""Export: what edgectl knows, in the words of other programs."""
