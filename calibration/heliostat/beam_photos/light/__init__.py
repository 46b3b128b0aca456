"""The light on the target: background, region of the beam, centroids, size, what to trust."""
