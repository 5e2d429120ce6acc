"""Measurements: what the preparation, and later the renderer, cost and how right they are."""
