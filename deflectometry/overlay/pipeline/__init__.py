"""The stages of an overlay, in a row in `measure`."""
