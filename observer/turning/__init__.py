"""A collector that turns before one fixed camera: where the camera is in the collector's frame at each reading."""
