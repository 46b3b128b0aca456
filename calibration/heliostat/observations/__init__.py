"""What was seen of a heliostat (beams, normals, points, the sun) and the observation equation of each kind."""
