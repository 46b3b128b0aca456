"""The stages of a laser scan, in a row in `measure`."""
