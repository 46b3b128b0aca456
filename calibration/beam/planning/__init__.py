"""What photos of a beam will tell of its mirror, before they are taken."""
