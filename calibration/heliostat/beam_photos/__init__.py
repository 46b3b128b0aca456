"""Photos of a beam on a target become centroids with sigma: target found, background removed, beam measured."""
