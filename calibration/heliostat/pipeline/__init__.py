"""The stages of a heliostat calibration: `one_heliostat` has them in a row, `measure` does it for a field."""
