"""What other programs and controllers can say of a heliostat, and what is lost when they say it."""
