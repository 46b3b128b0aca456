"""Plan of a photo of dots."""
