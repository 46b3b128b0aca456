"""Backward gazing: cameras near the receiver see how bright the sun's image is in each point of a heliostat."""
