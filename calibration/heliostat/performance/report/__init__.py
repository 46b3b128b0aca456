"""Reports of tests, and the data sheet."""
