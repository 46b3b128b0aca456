"""Calibration of heliostats: kinematic models with named parameters, their estimation, and how far to trust them."""
