"""Fringe images of mirrors with known errors."""
