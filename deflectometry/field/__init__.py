"""A heliostat where it stands in its field, and cameras that look at it: what measurements by sun and stars share."""
