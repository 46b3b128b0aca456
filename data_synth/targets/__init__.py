"""Photos of coded targets and calibration boards at known places."""
