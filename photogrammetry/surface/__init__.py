"""Points to surface: fit to the design, slopes, canting, displacement, CAD meshes."""
