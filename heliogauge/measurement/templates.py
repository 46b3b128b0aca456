"""Commented measurement.toml files to start from."""

from difflib import get_close_matches
from pathlib import Path

from heliogauge.errors import InputError
from heliogauge.measurement.heliostat_template import HELIOSTAT_TEMPLATE
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.measurement.plan_templates import OBSERVER_PLAN, PHOTOGRAMMETRY_PLAN
from heliogauge.measurement.surface_template import SURFACE_TEMPLATE
from heliogauge.measurement.writer import write_text

_DEFLECTOMETRY = """\
# A deflectometry measurement: images of fringes on a screen, seen in a mirror.
# Lines that begin with # are comments; those that begin with #: are keys you may want. Files are beside this one.
# Units are in the key names. Lengths in metres, angles of rotation vectors in radians, sigma = 1 standard deviation.

kind = "deflectometry"
name = "facet 1"
#: date = 2026-01-31
#: notes = "after cleaning, 21 degrees Celsius"

# The camera. Either a file from a calibration, or the parameters themselves. Pixel (0, 0) is the centre of the top-left
# pixel; x to the right, y down, z forward. Distortion: Brown's model on normalised coordinates.
[camera]
#: file = "camera.json"          # instead of all the keys below
width_px = 1624
height_px = 1232
focal_x_px = 2400.0
focal_y_px = 2400.0
center_x_px = 811.5
center_y_px = 615.5
k1 = 0.0
k2 = 0.0
k3 = 0.0
p1 = 0.0
p2 = 0.0
distortion_direction = "ideal_to_measured"    # as in OpenCV; or "measured_to_ideal" as in photogrammetry
# Without sigmas the camera counts as exactly known.
#: sigma_focal_px = 1.0
#: sigma_center_px = 1.0
#: sigma_k1 = 0.001

# The screen and its pose cam_from_screen: x_cam = R(rotation_vector) x_screen + translation. The screen's frame has its
# origin in the middle, x to the right and y up as a viewer sees the screen, z towards the viewer.
[screen]
shape = "rectangle"             # or "table"
width_m = 1.2                   # size of the displayed image, not of the housing
height_m = 0.7
#: file = "screen_points.csv"    # for shape = "table", instead of the size: columns u, v, x_m, y_m, z_m
rotation_vector_rad = [0.0, 0.0, 3.141592653589793]
translation_m = [0.0, -0.6, 0.0]
sigma_rotation_mrad = 1.0       # one number, or one for each axis: [1.0, 1.0, 2.0]
sigma_translation_mm = 1.0
#: sigma_points_mm = 0.1         # how far points of the screen are off its shape
#: response_file = "response.csv"    # columns camera_dn, display_level: what the camera sees of each level

# The pattern: sets of frames in the order in which they were taken. axis "x": fringes change from left to right,
# "y": from top to bottom. Frame k shows a + b cos(2 pi periods w - step_k), w from 0 to 1 over the displayed image.
[[pattern.set]]
axis = "y"
periods = 0.9
steps_deg = [0, 90, 180, 270]

[[pattern.set]]
axis = "y"
periods = 15.9
steps_deg = [0, 90, 180, 270]

[[pattern.set]]
axis = "x"
periods = 0.9
steps_deg = [0, 90, 180, 270]

[[pattern.set]]
axis = "x"
periods = 15.9
steps_deg = [0, 90, 180, 270]

# The images: JPEG, PNG or TIFF, 8 or 16 bit, mono or colour, all of one size. A text with * takes all files that match,
# sorted so that fringe_2 comes before fringe_10; or list them: ["a.png", "b.png"].
[images]
fringes = "fringe_*.png"
#: dark = "dark.png"             # screen black: helps to find the mirror
#: bright = "bright.png"         # screen white
#: saturation_dn = 250           # the level that counts as saturated; default: the largest the file format can hold
#: pixel_noise_dn = 1.0          # standard deviation of a pixel; default: estimated from the frames

# The mirror. Facet frame: x width and y height seen from the front, z out of the mirror.
# Designs: plane | paraboloid (focal_length_m) | paraboloid_xy (focal_length_x_m, focal_length_y_m) | sphere (radius_m)
#          trough (focal_length_m, z = x^2 / 4 f)
#          quadric (coefficients = [A, B, C, D, E, F] of z = A x^2 + B y^2 + C x + D y + E x y + F)
[mirror]
design = "paraboloid"
focal_length_m = 10.0
# Corners in the facet frame, counter-clockwise seen from the front. Leave out for an undefined outline.
outline_m = [[-0.6, -0.6], [0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]]
#: outline_sigma_mm = 0.5           # how far the sides of the real mirror may be from that outline; default: 0, exact
#: roll_deg = 0.0                   # from the image's x axis to the mirror's, counter-clockwise as displayed: say 90 or
#                                   # 180 for a camera that lies on its side or stands on its head
#: design_center_m = [0.0, 0.0]     # where on the optic the facet's origin sits: not [0, 0] for an off-axis facet
#: design_orientation = "normal"    # facet z along the surface's normal there, or "axis": along the optic's axis
#: reference_point_m = [0.0, 0.0]   # the point the results refer to; default: the outline's centroid

# The measured distance from a point of the mirror to the middle of the screen. It enters one adjustment together with
# the outline, weighted by its sigma.
[mirror.distance]
distance_m = 10.0
sigma_mm = 2.0
point_m = [0.0, 0.0, 0.0]

# A pose that is known otherwise (cam_from_facet) replaces the adjustment to the outline.
#: [mirror.pose]
#: rotation_vector_rad = [3.141592653589793, 0.0, 0.0]
#: translation_m = [0.0, 0.0, 10.0]
#: sigma_rotation_mrad = 0.5
#: sigma_translation_mm = 1.0

# Points with known coordinates that were measured in the image, any number.
#: [[mirror.known_point]]
#: point_m = [0.6, 0.6, 0.0]
#: image_px = [1200.5, 300.25]
#: sigma_px = 0.2

# Several facets in one image: take outline_m out above and describe each facet. position_m and rotation_vector_rad are
# ensemble_from_facet; [mirror.pose] and the distance then belong to the ensemble's frame.
#: [[mirror.facet]]
#: name = "A1"
#: outline_m = [[-0.6, -0.6], [0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]]
#: position_m = [0.0, 0.0, 0.0]
#: rotation_vector_rad = [0.0, 0.0, 0.0]

[evaluation]
align = "normal"                # turn the mirror so that its mean normal is the design's; "outline" keeps the pose
remove = "nothing"              # what the headline numbers leave out: nothing | tilt | focus | quadratic
#: grid_step_mm = 5.0            # default: 0.4 of an image pixel on the mirror
"""

_RESPONSE = """\
# The response of camera and display: one photograph for each of several uniform grey levels on the display.
# `heliogauge deflectometry patterns` makes such levels (grey_000.png ...) and this file for them (grey.toml).
# Lines that begin with # are comments; those that begin with #: are keys you may want. Files are beside this one.

# Put the camera where it sees the display, itself or in the mirror, with the exposure of the fringes. The brightest
# level must not saturate. Keep room light, exposure and white balance the same for all photographs.

kind = "response"
name = "monitor and camera 1"
#: date = 2026-01-31
#: notes = "projector warm for 30 minutes"

# Levels in the order of the photographs, dark to bright. More levels follow the curve more closely.
[display]
levels = [0, 16, 32, 48, 64, 80, 96, 112, 128, 144, 160, 176, 192, 208, 224, 240, 255]
full_level = 255                # the display's brightest level: 255 for 8 bit, 1 for levels written as fractions

[images]
grey = "grey_*.png"             # as fringes: a text with * (natural order), or a list
#: saturation_dn = 250           # the level that counts as saturated; default: the largest the file format can hold
#: region_px = [100, 80, 900, 700]    # x, y of the first and of the last pixel that sees the display; default: pixels
#                                     # that brighten by at least half of what the brightest do
"""

_CAMERA = """\
# Calibration of a camera: photos of a board. Camera, poses and the board's own shape are found in one adjustment.
# Lines that begin with # are comments; those that begin with #: are keys you may want. Files are beside this one.
# `heliogauge photogrammetry sheets` prints boards in true scale.

# Take 10 to 20 photos with focus, zoom and aperture as they will be used: the board tilted by 30 to 45 degrees to all
# sides, at different distances, the camera turned by 90 degrees for some, the board in every corner of the image.

kind = "camera"
name = "camera 1"
#: date = 2026-01-31
#: notes = "lens at f/8, focus taped"

[camera]
#: name = "camera"              # its name in cameras.json
#: width_px = 1624              # size of the photos, as a check
#: height_px = 1232
# What is estimated; the rest is held (aspect and distortion at 0, principal point in the middle). Lens: Brown's model.
#: free = ["focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "p1", "p2", "k3"]

# The board. Its shape is estimated, so a print need not be flat or square. Without the size in mm lengths are in
# squares (pitches); the camera is the same.
[board]
type = "chessboard"             # chessboard | charuco | circles | circles-asymmetric | targets
columns = 9                     # inner corners in a row (charuco: squares; circles: dots)
rows = 6                        # best one even, one odd number: only then the print shows how a photo is turned
square_mm = 30.0
#: type = "charuco"             # with columns, rows, square_mm and
#: marker_mm = 22.0
#: dictionary = "DICT_5X5_100"
#: type = "circles"             # with columns, rows and
#: pitch_mm = 30.0
#: diameter_mm = 15.0
#: type = "targets"             # ring-coded targets, on a plate or anywhere
#: dictionary = "aicon-12"      # or a file with ring codes of your own: "codes.csv" (see docs/targets.md)
#: file = "targets.csv"         # rough places: columns id, x_m, y_m (z_m); without it nothing is known of them

[images]
photos = "photo_*.png"          # a text with * (natural order), or a list
"""

_PHOTOGRAMMETRY = (
    """\
# Photogrammetry: photos of targets to coordinates with standard deviations, poses and a calibrated camera.
# Lines that begin with # are comments; those that begin with #: are keys you may want. Files are beside this one.
# `heliogauge photogrammetry sheets` prints targets in true scale.

# Walk round the object: 60 to 90 degrees between the outermost photos, every target in at least four, the camera turned
# by 90 degrees for some. Same focus, zoom and aperture for all.

kind = "photogrammetry"
name = "collector 1"
#: date = 2026-01-31
#: notes = "22 degrees Celsius"

# The camera. With nothing said it calibrates itself. A known camera is held, unless free names what is estimated.
[camera]
#: name = "camera"              # its name in cameras.json
#: file = "camera.json"         # from `heliogauge calibrate camera`
#: prior = true                 # with a file and free: its covariance holds them
#: width_px = 6000              # needed with image points, where no file says it
#: height_px = 4000
#: focal_length_35mm = 24.0     # a start, as on the lens for a 36 mm x 24 mm film, where 28 mm is far off
#: free = ["focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "p1", "p2", "k3"]    # or "skew"; [] for none
#: residuals = "measured"       # or "corrected": formed in an image without lens, as DBAT's backward models have it
#: [camera.sigma]               # single values known before, of those in free
#: focal_px = 2.0
# A camera as photogrammetric programs print it, instead of the file. Corrections of measured coordinates, unless
# distortion_direction = "ideal_to_measured"; the results come in the same form too (camera_millimetres.csv).
#: [camera.millimetres]
#: form = "brown"               # K1-K3, P1, P2, aspect, shear (DBAT, PhotoModeler); "aicon": A1-A3, B1, B2, C1, C2
#: pixel_mm = 0.0032            # height of a pixel
#: focal_mm = 7.5
#: principal_mm = [0.1, -0.05]  # default: the middle
#: principal_origin = "center"  # or "corner", of the first pixel, to the right and down
#: y_axis = "up"                # of the lens
#: radial = [4.6e-3, -4.5e-5, 0.0]
#: tangential = [-6.1e-5, -4.4e-5]
#: affine = [0.0, 0.0]
#: zero_radius_mm = 0.0         # r0, with form = "aicon"
# Several cameras, or positions of a zoom: [[camera]] instead of [camera] for each, with its name and, but for one that
# takes the rest, photos = ["A_*.jpg"].

# Photos, each camera's of one size ...
[images]
photos = "photo_*.jpg"          # a text with * (natural order), or a list

[targets]
dictionary = "aicon-12"         # ring codes aicon-8 to -20, metashape-12 to -20; or square markers: "DICT_4X4_100"
                                # or a file with ring codes of your own: "codes.csv", "codes.toml"
#: polarity = "both"            # black-on-white | white-on-black | both
#: smallest_px = 6.0            # diameter of the dots in the photos
#: largest_px = 300.0
#: charuco = { columns = 7, rows = 10, square_mm = 22.0, marker_mm = 15.4 }   # a board of those markers: its inner
                                # corners are points "board.0", "board.1"... row by row from its top left
#: sense = "counterclockwise"   # ring codes printed in the other sense than the dictionary counts (see docs/targets.md)
#: ring_inner_radius = 2.0      # where the code ring begins and ends, in radii of the dot
#: ring_outer_radius = 3.0
#: diameter_mm = 14.0           # of all dots: helps targets seen twice only, and is checked
#: find_uncoded = true          # dots without a code, by the poses of the coded targets; the default for ring codes
#: uncoded_file = "rim.csv"     # names and rough places: id, x_m, y_m, z_m, sigma_mm; without dictionary these tell
#: up = [0.0, 1.0, 0.0]         # all dots, with a known camera; up and front settle symmetric layouts
#: front = [0.0, 0.0, 1.0]
#: tracked_from = "marks.csv"   # or follow marks set by hand in one photo: image, target, x_px, y_px
#: search_radius_px = 100.0

# Features of the surface itself, beside targets or instead of them; needs pip install heliogauge[natural].
#: [natural]
#: max_features = 4000          # of each photo
#: min_photos = 3               # that must show a point
#: max_points = 2000

# ... or image points that another program measured (columns image, target, x_px, y_px, sigma_x_px, sigma_y_px).
#: [image_points]
#: file = "image_points.csv"
#: pixel_origin = "corner"      # where (0, 0) is: "center" or outer "corner" of the top-left pixel

# Known distances; check_only keeps one out of the adjustment, as a test of it.
# Targets by number; corners of square markers by marker and corner, clockwise from its top left: "23.0" to "23.3".
[[scale_bar]]
a = "1"
b = "2"
length_m = 1.5
sigma_mm = 0.02
#: check_only = false

# How far a length may be off, a + L / k but at most b, as VDI/VDE 2634 part 1 has it: said of bars that were not used.
#: [permissible_length_error]
#: a_mm = 0.02
#: k = 100000.0                 # 0.01 mm more for each metre
#: b_mm = 0.1

# Control points; without sigma_mm they are held exactly.
#: [[control_point]]
#: target = "7"
#: xyz_m = [0.0, 0.0, 0.0]
#: sigma_mm = 0.1

#: [[constraint]]
#: kind = "coordinate"
#: target = "5"
#: axis = "z"
#: value_m = 0.0
#: sigma_mm = 0.1
#: [[constraint]]
#: kind = "distance"
#: a = "5"
#: b = "6"
#: distance_m = 2.0
#: sigma_mm = 1.0
#: [[constraint]]
#: kind = "plane"               # of its own, or a known one with normal = [0.0, 0.0, 1.0] and offset_m = 0.0
#: targets = ["1", "2", "3", "4", "5"]
#: sigma_mm = 0.05

# The same as tables: control_points with columns target, x_m, y_m, z_m (sigma_x_mm, sigma_y_mm, sigma_z_mm);
# scale_bars with a, b, length_m, sigma_mm (check_only: 0 or 1); coordinates with target, axis, value_m, sigma_mm.
#: [files]
#: control_points = "control.csv"
#: scale_bars = "scale_bars.csv"
#: coordinates = "coordinates.csv"

# Targets on the rim of a parabolic trough, y along it: x = -w/2 or w/2, z = w^2 / (16 f); y = 0 at one end.
#: [collector]
#: width_m = 5.76
#: focal_length_m = 1.71
#: left = ["11", "12", "13"]
#: right = ["21", "22", "23"]
#: end = ["11", "21"]
#: along = [["11", "13"], ["21", "23"]]
#: length_m = 11.9
#: sigma_mm = 1.0
#: length_sigma_mm = 2.0

# Start values, from an earlier result for example; without them the network starts from the image points alone. Where
# nothing below or above says otherwise, position, rotation and scale are theirs.
#: [start]
#: cameras = "start/cameras.json"
#: points = "start/points.csv"

# Position, rotation and scale as far as the above leaves them open: "inner" constraints over all or some targets;
# "minimal" (3-2-1) with three targets; "photos" with photos = ["a.jpg"] that stay (two without scale); "control":
# nothing may be left open.
#: [datum]
#: kind = "inner"
#: targets = ["1", "2", "3", "4"]

#: [adjustment]
#: reject = true                # leave out image points that contradict the others
#: family_significance = 0.05   # probability of leaving out any good one of all
#: sigmas = "from residuals"    # or "stated"; default: from residuals for photos, stated for image points with sigma
"""
    + SURFACE_TEMPLATE
)

_OBSERVER = """\
# Photos of the absorber's reflection in a parabolic trough: slope errors, absorber position, intercept factor.
# Lines that begin with # are comments; those that begin with #: are keys you may want. Files are beside this one.
# Frame: origin at the vertex in the middle of the length, x across the aperture, y along, z to the absorber.

kind = "observer"
name = "collector 1"

[collector]
aperture_width_m = 5.0
length_m = 7.89
focal_length_m = 1.49
absorber_diameter_mm = 70.0
#: glass_outer_diameter_mm = 115.0
#: glass_inner_diameter_mm = 109.0
#: glass_index = 1.47
#: panel_edges_x_m = [-2.5, -1.34, 0.0, 1.34, 2.5]   # all edges of the mirror panels, also the outer ones
#: panel_edges_y_m = [-3.945, -2.367, -0.789, 0.789, 2.367, 3.945]
#: panel_gap_mm = 10.0
#: panel_height_sigma_mm = 0.2   # how well the mean height of each panel is the design's; 1 where nobody measured it
#: support_y_m = [-3.945, 0.0, 3.945]                # receiver supports: the tube is not seen there
#: support_width_m = 0.3
#: orientation_deg = 0.0        # 0: the collector looks to the zenith

# As in photogrammetry: a calibrated camera by its file, or written out; unknown: it calibrates itself.
[camera]
file = "camera.json"
#: width_px = 1920
#: height_px = 1080
#: focal_px = 2381.0

# The camera crosses the optical axis above the mirror: the absorber's reflection must pass every part of the mirror.
[images]
photos = "*.jpg"
#: video = "pass.mp4"           # instead of photos
#: every_nth = 5                # of the video's frames
#: encoding = "srgb"            # or "linear"; without it targets and edges of the reflection tell

# Coded targets on the rim (ring codes aicon-12, ... or markers DICT_4X4_100); targets.csv has the columns
# target, x_m, y_m, z_m, sigma_x_mm, sigma_y_mm, sigma_z_mm; leave a cell empty where a coordinate is not known.
[targets]
dictionary = "aicon-12"
diameter_mm = 60.0
file = "targets.csv"

#: [[scale_bar]]
#: a = "1"
#: b = "6"
#: length_m = 7.52
#: sigma_mm = 3.0

# Several collectors in the same photos: a table for each; its results get a folder of its name, beside one overview.
#: [[module]]
#: name = "row-1"
#: place_m = [0.0, 0.0, 0.0]    # its origin in the frame of the list of targets
#: turn_deg = 0.0               # its turn there, right-handed about +y
#: targets_file = "row-1.csv"   # instead: a list of its own, in its own frame
#: [module.collector]           # where it is built otherwise: all keys of [collector]

# Where the absorber is: measured in the same photos (default), in photos of its own, read, or taken from the design.
#: [absorber]
#: source = "photos"            # or "file" with file = "absorber.csv", or "design"
#: photos = "absorber_*.jpg"
#: station_step_m = 0.25

# The light for the intercept factor.
#: [sun]
#: shape = "gaussian"           # with sigma_mrad; pillbox: half_angle_mrad; buie: circumsolar_ratio; table: file
#: sigma_mrad = 2.73
#: [optics]
#: specularity_mrad = 0.0       # of the reflected beam, 1 sigma in one direction
#: tracking_error_mrad = 0.0    # of the rotation about the trough's length, 1 sigma

#: [evaluation]
#: row_step_mm = 20.0
#: column_step_mm = 20.0
#: largest_slope_error_mrad = 12.0
#: longitudinal_slope_mrad = 2.0   # standard deviation of slopes along the trough, where one pass cannot measure them
#: shape_from_slopes = true        # lines of sight meet the mirror as measured; false for normals turned on the design;
#:                                 # without it: from the reflection itself
"""

_TEMPLATES: dict[str, str] = {
    "deflectometry": _DEFLECTOMETRY,
    "response": _RESPONSE,
    "camera": _CAMERA,
    "photogrammetry": _PHOTOGRAMMETRY,
    "photogrammetry-plan": PHOTOGRAMMETRY_PLAN,
    "observer": _OBSERVER,
    "observer-plan": OBSERVER_PLAN,
    "heliostat": HELIOSTAT_TEMPLATE,
}


def write_template(kind: str, folder: Path, *, force: bool = False) -> Path:
    """Write a commented measurement.toml for one kind of measurement.

    force: Replace a file that is there.
    InputError: The kind is not available, the file exists already, or the folder cannot be made.
    """
    if kind not in _TEMPLATES:
        near = get_close_matches(kind, _TEMPLATES, n=1)
        hint = f"did you mean {near[0]}?" if near else f"available are: {', '.join(_TEMPLATES)}"
        raise InputError(f"init: kind {kind!r} is not available in this version; {hint}")
    file = folder / MEASUREMENT_FILE
    if file.exists() and not force:
        raise InputError(f"{file}: the file exists already; add --force to replace it, or give another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made a folder ({error.strerror}); give another one") from error
    return write_text(file, _TEMPLATES[kind])
