"""Rules that several rooms share: pure functions over the model."""
