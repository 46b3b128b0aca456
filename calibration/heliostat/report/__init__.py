"""Figures and sections of the report of a heliostat and of a field."""
