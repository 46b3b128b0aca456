"""What the measured mirror does to sunlight: intercept factor with sigma."""
