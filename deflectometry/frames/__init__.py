"""Faulty frames are named before they spoil the map: repeated, stale, swapped, saturated."""
