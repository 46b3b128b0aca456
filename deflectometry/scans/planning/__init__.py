"""Plans of scans of the surface."""
