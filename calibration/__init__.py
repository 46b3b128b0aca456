"""Calibration of cameras, screens and heliostats."""
