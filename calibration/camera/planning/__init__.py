"""Which photos of the board to take next, and what a calibration will be worth with them."""
