"""Results of tests and data sheets on disk."""
