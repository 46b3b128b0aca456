"""Many measurement folders at once: found, named, measured side by side, listed in one index."""
