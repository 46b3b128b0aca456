"""From tables of what was done to entries of a data sheet."""
