"""Files of other programs: COLMAP models, tables of image points."""
