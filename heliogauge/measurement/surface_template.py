"""What the template of ``heliogauge init photogrammetry`` says of the surface."""

SURFACE_TEMPLATE = """
# The surface under the targets: its best fit, deviations, slope map, canting of facets.
#: [surface]
#: design = "paraboloid"        # plane | paraboloid | paraboloid_xy | trough | sphere | quadric, as of a mirror
#: focal_length_m = 1.7         # sphere: radius_m; paraboloid_xy: focal_length_x_m, focal_length_y_m
#: fit = "rigid"                # "focal-length" frees it too; "none" keeps the network's frame, or that of references
#: robust = true                # points far from the rest do not count; surface.csv says which and why
#: targets = ["1..40", "A*"]    # names, ranges, patterns; all without it
#: outline_m = [[-0.6, -0.8], [0.6, -0.8], [0.6, 0.8], [-0.6, 0.8]]   # of the slope map, in the design's frame
#: slope_map = true
#: grid_step_mm = 50.0          # half the distance of the targets without it
#: ply = true                   # points.ply, coloured by deviation; needs pip install heliogauge[3d]
#: compare_with = "../spring/result"   # an earlier result: what moved since
#: stable_targets = ["101..104"]       # targets at rest; found by the test itself without it
# Targets whose place on the design is known: three or more place the frame, and a bowl that is round or shallow.
#: [[surface.reference]]
#: target = "1"
#: xyz_m = [-0.5, -0.7, 0.11]
#: [[surface.reference]]
#: target = "2"
#: xyz_m = [0.5, -0.7, 0.11]
#: [[surface.reference]]
#: target = "3"
#: xyz_m = [0.5, 0.7, 0.11]
# Facets on one structure: canting and focal length of each; with a design of its own also position_m and
# rotation_vector_rad.
#: [[surface.facet]]
#: name = "upper left"
#: targets = ["1..12"]
# Instead of a design a CAD mesh: mesh = "part.stl", mesh_unit = "mm".
"""
