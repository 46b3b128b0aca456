"""What a slope map does to sunlight."""
