"""Photos of parabolic troughs in which the absorber is seen, with known errors."""
