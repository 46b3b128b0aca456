"""A mirror's surface, the flux that it sends to a target, and what photos of its beam tell of it."""
