"""Calibration of a screen: its response from display level to camera signal, its pose and its shape."""
