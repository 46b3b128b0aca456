"""The stages of a deflectometric measurement, in a row in `measure`."""
