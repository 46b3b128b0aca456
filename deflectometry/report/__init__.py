"""The report of a deflectometric measurement: what its notebook shows."""
