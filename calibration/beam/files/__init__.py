"""Results of measured beams on disk."""
