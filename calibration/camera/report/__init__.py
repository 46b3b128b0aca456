"""Figures and sections of the report of a calibrated camera."""
