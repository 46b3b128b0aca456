"""Which edges are the tube's, and why the others are refused."""
