"""Rigid motions, rays, surfaces, places on Earth, the sun."""
