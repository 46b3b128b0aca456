"""Description of a set-up: patterns, screen, facets. Estimates nothing."""
