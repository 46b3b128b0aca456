"""Figures and sections of the report of a photo network."""
