"""Camera, poses and the shape of the board in one adjustment; single photos against it."""
