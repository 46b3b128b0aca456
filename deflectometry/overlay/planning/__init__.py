"""Plans of overlays: how sure the turns of facets will be, and which facets no photo will show."""
