"""Plan of a laser scan."""
