"""Beams, sightings and photos of heliostats with known errors."""
