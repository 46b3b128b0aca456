"""Report of a store."""
