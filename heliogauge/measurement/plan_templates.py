"""Commented measurement.toml of plans: a photo network, a pass over a trough."""

PHOTOGRAMMETRY_PLAN = """\
# Plan of a photogrammetric measurement: how many photos, from where, for a wanted sigma.
# Lines that begin with # are comments; those that begin with #: are keys you may want. Files are beside this one.
# `heliogauge photogrammetry plan FOLDER -o OUT` writes stations.csv, the sigmas to be expected, and a report.

kind = "photogrammetry-plan"
name = "collector 1"

# A design surface with targets at equal spacing, z out of the mirror: plane | paraboloid | sphere | trough ...
[object]
design = "trough"
focal_length_m = 1.71           # sphere: radius_m
width_m = 4.0                   # along x, across the trough
height_m = 2.0                  # along y
spacing_m = 0.4
#: center_m = [0.0, 0.0]        # the object's middle, for a panel beside the vertex
diameter_mm = 20.0              # of the targets' dots; 0: their size in the image does not matter
# ... or a list of targets: columns id, x_m, y_m, z_m and, for targets with one face, normal_x, normal_y, normal_z.
#: targets = "targets.csv"

[camera]
width_px = 6000
height_px = 4000
focal_px = 6100.0               # focal length over pixel pitch
#: file = "camera.json"         # instead of these three
sigma_px = 0.04                 # standard deviation of an image coordinate
#: free = ["focal_px", "center_x_px", "center_y_px", "k1", "k2"]   # estimated; [] for a camera that is known
#: smallest_px = 6.0            # smallest diameter in the image

# Cameras stand on rings round the object's normal, in pairs of rings or on one.
[stations]
#: distance_m = 6.0             # default: where the object fills the image
#: rings_deg = [20.0, 35.0, 50.0]    # angles from the normal
#: up = [0.0, 1.0, 0.0]         # the vertical in the object's frame: y for a mirror that looks at the horizon
#: lowest_m = -1.0              # heights along it between which the camera can be
#: highest_m = 3.0
#: turned = true                # every other photo with the camera turned by 90 degrees
#: largest_incidence_deg = 65.0 # between a target's normal and the ray

# Scale bars with a target at either end.
[[scale_bar]]
from_m = [-1.0, -1.2, 0.3]
to_m = [1.0, -1.2, 0.3]
sigma_mm = 0.01

[goal]
sigma_mm = 0.03
of = "rms"                      # of all coordinates' sigmas, or the "largest"
#: most_photos = 80
"""

OBSERVER_PLAN = """\
# Plan of a pass over a trough: what the photos will tell of mirror and absorber, before anyone goes out.
# Lines that begin with # are comments; those that begin with #: are keys you may want. Files are beside this one.
# `heliogauge observer plan FOLDER -o OUT` writes stations.csv, the map of expected sigmas, and what will be missing.

kind = "observer-plan"
name = "collector 1"

[collector]
aperture_width_m = 5.0
length_m = 7.89
focal_length_m = 1.49
absorber_diameter_mm = 70.0
glass_outer_diameter_mm = 115.0
glass_inner_diameter_mm = 109.0
#: panel_edges_x_m = [-2.5, -1.34, 0.0, 1.34, 2.5]   # all edges of the panels, those of the aperture too
#: panel_edges_y_m = [-3.945, 0.0, 3.945]
#: panel_gap_mm = 10.0
#: panel_height_sigma_mm = 0.2   # how well the mean height of each panel is the design's; 1 where nobody measured it
#: support_y_m = [-3.945, 0.0, 3.945]   # receiver supports
#: support_width_m = 0.3

[camera]
width_px = 1920                 # along the trough
height_px = 1080                # across it
focal_px = 2381.0               # focal length over pixel pitch
#: file = "camera.json"         # instead of these three
#: free = ["focal_px"]          # estimated by the measurement; a camera that is given is held otherwise
#: sigma = { focal_px = 0.5 }   # what its calibration is good for

# So many targets evenly along both rims, or a table: columns target, x_m, y_m, z_m, sigma_x_mm, sigma_y_mm, sigma_z_mm;
# empty sigmas: the place is planned, but unknown.
[targets]
rim_count = 12
sigma_mm = 1.0                  # of each coordinate
#: file = "targets.csv"         # instead of these two
sigma_px = 0.1                  # of a target's image

#: [[distance]]                 # tape measurements between targets
#: kind = "distance"
#: a = "1"
#: b = "6"
#: distance_m = 7.8
#: sigma_mm = 3.0

# One table for each pass across the aperture.
[[flight]]
height_m = 15.0                 # above the vertex
reach_m = 3.0                   # photos from x = -3 m to 3 m
photos = 100
#: y_m = 0.0                    # where along the trough the camera is ...
#: look_y_m = 0.0               # ... and where it looks

[mirror]
slope_error_mrad = 3.0          # RMS across the trough
#: longitudinal_error_mrad = 1.8
#: like = "../result"           # the mirror and absorber of an earlier result instead
#: seed = 0

[noise]
reflection_px = 0.05            # sigma of an edge of the reflection; Owkes (2012) takes 1 pixel
absorber_px = 0.05              # sigma of the tube's middle

#: [absorber]
#: source = "design"            # its place is believed instead of measured
#: station_step_m = 0.25

#: [monte_carlo]
#: runs = 200                   # repeat the whole evaluation with everything uncertain disturbed
#: row_step_mm = 200.0
#: seed = 0

#: [evaluation]
#: row_step_mm = 20.0
#: column_step_mm = 20.0
#: longitudinal_slope_mrad = 2.0
"""
