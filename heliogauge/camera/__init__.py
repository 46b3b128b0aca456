"""The camera model: distortion in both directions, derivatives, covariance; parameters of other programs."""
