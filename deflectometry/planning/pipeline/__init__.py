"""From measurement.toml without images to the plan and its alternatives."""
