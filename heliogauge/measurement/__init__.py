"""measurement.toml: found by kind, checked, written."""
