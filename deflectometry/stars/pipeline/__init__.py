"""The stages of a measurement by stars, in a row in `measure`."""
