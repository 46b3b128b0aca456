"""The stages of a scan of the surface, in a row in `measure`."""
