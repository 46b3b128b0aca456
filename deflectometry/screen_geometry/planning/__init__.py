"""Plans of screens: how sure points, size and the measuring camera's pose will be, from predicted image points."""
