"""The stages of a measurement in several poses, in a row in `measure`."""
