"""Scans of the surface itself, by laser tracker or scanner: points, with or without normals, to slopes."""
