"""What is done with finished measurements: absorber alone, alignment, comparison, overview, several modules."""
