"""The stages of the Observer, in a row in `measure`."""
