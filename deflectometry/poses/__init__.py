"""One mirror in several poses: camera, screen and surface from one adjustment."""
