"""The stages of a camera calibration, in a row in `measure`."""
