"""Start values of poses and points from nothing but image points."""
