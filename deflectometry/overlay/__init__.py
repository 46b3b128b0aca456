"""The image of a source in each facet of a heliostat, as it should be, and the turn that brings it there."""
