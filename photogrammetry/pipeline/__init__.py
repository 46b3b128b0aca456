"""The stages of a photogrammetric measurement, in a row in `measure`."""
