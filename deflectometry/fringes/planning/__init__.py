"""Plan of fringes before a screen, near or far."""
