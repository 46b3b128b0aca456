"""Deflectometry: images of a fringe pattern seen in a mirror to a slope map with its uncertainty."""
