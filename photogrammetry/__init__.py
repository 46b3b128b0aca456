"""Photogrammetry: photos of targets to poses and coordinates with standard deviations."""
