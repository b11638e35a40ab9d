"""The nouns: frozen, slotted, keyword-only dataclasses. Nothing here does I/O."""
