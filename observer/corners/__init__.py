"""Corners of the mirror panels as natural targets: predicted from the drawing, found where lines of the photo cross."""
