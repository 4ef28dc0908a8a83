"""Drawing directions: routines for single lobes, and mixtures of them for whole models."""
