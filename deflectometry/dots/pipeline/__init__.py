"""A photo of dots seen in a mirror to its result: the stages in a row."""
