"""Where the target is in a photo, and the photo on the plane of the target."""
