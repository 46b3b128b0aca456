"""Slopes of rows become the slope map, panels, sums with sigma."""
