"""Stars seen in the facets of a heliostat at night: which they are, and how each facet leans."""
