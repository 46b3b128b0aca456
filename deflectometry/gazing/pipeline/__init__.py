"""The stages of backward gazing, in a row in `measure`."""
