"""Integrators: they know cells, rules and bounds, and nothing of reflectance models."""
