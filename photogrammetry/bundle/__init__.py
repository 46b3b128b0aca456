"""The bundle adjustment: poses, points and cameras with covariance, datum, diagnosis."""
