"""Fringe images become phases, phases become the screen point that each pixel sees."""
