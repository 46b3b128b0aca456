"""What a calibrated camera is worth: sigma of its rays, comparison of two calibrations, doubts."""
