"""The file measurement.toml: found by its kind, checked, written."""
