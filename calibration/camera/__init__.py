"""Calibration of a camera from photos of a board: intrinsics, poses and the board's own shape in one adjustment."""
