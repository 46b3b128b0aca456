"""Photos of beams, one after the other, to places on their targets."""
