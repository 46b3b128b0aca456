"""Which photos a wanted sigma takes, and what a planned network will be worth."""
