"""Which sun positions to measure next, for whom first, and what that will be worth."""
