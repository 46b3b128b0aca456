"""The stages of a comparison, and what comes of it."""
