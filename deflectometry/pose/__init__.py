"""Where the mirror is: outline, known points and distance in one adjustment."""
