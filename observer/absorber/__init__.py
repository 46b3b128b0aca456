"""The absorber itself: its bearings in the photos, its place and shape."""
