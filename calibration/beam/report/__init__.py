"""Sections of the report of measured beams: from the files of their results."""
