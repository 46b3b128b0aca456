"""Description of a trough: collector, absorber path, glass, visibility. Estimates nothing."""
