"""Files of other programs: towers and records of the PAINT database."""
