"""Results of a camera calibration: what they hold, their files, their summary."""
