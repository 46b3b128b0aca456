"""From results to the store, and from the store to its report."""
