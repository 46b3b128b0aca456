"""A whole network: solved, its quality, its sigmas by kind, its lengths."""
