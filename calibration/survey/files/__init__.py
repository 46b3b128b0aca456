"""The store on disk, and what of a result goes into it."""
