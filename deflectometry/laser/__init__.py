"""Laser scans (VSHOT): a beam in a known direction, the spot that it makes after the mirror, and the slope between."""
