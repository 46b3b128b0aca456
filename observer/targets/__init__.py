"""The list of targets: which of them belong to a collector, and whether they are those in the photos."""
