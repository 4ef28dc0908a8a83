"""What albedos say about a model: one file, one question."""
