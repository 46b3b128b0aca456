"""What the measurement.toml of a photo network may say."""
