"""Corners and circles of a board in a photo: found, refused with a reason, placed to hundredths of a pixel."""
