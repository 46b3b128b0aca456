"""What is wrong with a heliostat or its records: hypotheses, their evidence, drift."""
