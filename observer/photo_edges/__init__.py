"""Edges of the absorber's reflection, of the mirror and of the tube in the photos."""
