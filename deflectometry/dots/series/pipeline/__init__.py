"""A series of photos of dots to one result for each frame: the stages in a row."""
