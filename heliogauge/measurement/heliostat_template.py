"""The commented measurement.toml of ``kind = "heliostat"``."""

HELIOSTAT_TEMPLATE = """\
# Calibration of heliostats: where beams (or other sightings) were seen, and the drive readings -> a tracking model.
# Lines that begin with # are comments; those that begin with #: are keys you may want. Files are beside this one.
# Frame: x east, y north, z up [m]; azimuth 0 = north, clockwise; elevation as seen (refracted).

kind = "heliostat"
name = "field 1"

[site]
latitude_deg = 37.094
longitude_deg = -2.358
altitude_m = 500.0
#: pressure_hpa = 955.0         # default: the standard atmosphere at that altitude
#: temperature_c = 12.0

# Targets: centre, size and the azimuth they face (180: south), or the four corners as measured: upper left, upper
# right, lower right, lower left, as seen from the field.
[[target]]
name = "target"
center_m = [0.0, 0.0, 40.0]
width_m = 8.0
height_m = 6.0
facing_azimuth_deg = 0.0
#: corners_m = [[4.0, 0.0, 43.0], [-4.0, 0.0, 43.0], [-4.0, 0.0, 37.0], [4.0, 0.0, 37.0]]

# Cameras that see the sun in the mirror (kind "camera"): without center_m its place is estimated too.
#: [[camera]]
#: name = "mast"
#: center_m = [10.0, 0.0, 35.0]
#: sigma_m = 0.02

# Columns: heliostat, e_m, n_m, u_m (or lat_deg, lon_deg, alt_m), and any parameter of the model by its name.
[heliostats]
file = "heliostats.csv"

# One row for each observation: heliostat, time_utc (2026-06-21T10:00:00Z), axis_1_rad, axis_2_rad (or _deg, _counts),
# target, x_m, y_m (on the target: right, up from its centre; or e_m, n_m, u_m); if there are any: sigma_mm,
# sun_azimuth_deg, sun_elevation_deg, kind (beam, drone, camera, normal, point, lamp), image, split.
[observations]
file = "observations.csv"

[kinematics]
preset = "azimuth-elevation"    # or "drone", "six-error", "two-axes" (with axes, normal), "linear-actuators"
#: free = "8"                   # a usual choice of the preset, or names: ["tilt_north", "tilt_east"]
#: terms = ["worm", "sag", "backlash"]
#: worm_ratio = 30.0            # cycles of the periodic error per turn of the axis
#: counts_per_turn = 48000      # motor counts of rotary drives; [a, b] for two axes

# What is known of a parameter beforehand; sigma 0 holds it, inf leaves it to the observations.
#: [kinematics.parameters]
#: tilt_north = {value = 0.0, sigma = 0.005}

# Beams are measured in the photos that the column image names. Where the target is in them: corners_px (upper left,
# upper right, lower right, lower left), whole, markers, aruco_ids or dark_marks.
#: [[images]]
#: target = "target"
#: corners_px = [[102.0, 88.0], [1180.0, 90.0], [1176.0, 902.0], [105.0, 899.0]]
#: corners_sigma_px = 0.3       # how well they are known
#: empty = "empty_*.png"        # the target without a beam, for the background
#: camera = "camera.json"       # its lens, if it was calibrated

#: [paint]                      # instead of both tables: folders as of the PAINT database
#: folder = "."

#: [evaluation]
#: split = "chronological"      # or "random", "azimuth", "high-variance", "column": what the model is tried out on
#: model = "auto"               # or a usual choice of free parameters
#: label = "UTIS"               # or "HeliOS": centres of beams in PAINT's files
#: spot_sigma_mm = 50.0         # of a beam's centre, where the table gives none
"""
