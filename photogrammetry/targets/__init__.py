"""Description of coded targets and the sheets to print."""
