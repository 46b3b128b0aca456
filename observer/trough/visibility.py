"""Which part of a mirror can show the absorber tube to the cameras, and where a camera would have to be for the rest.

A line of sight from the mirror point P under the angle ``Phi`` across the trough touches the tube where ``Phi = 2
theta_ra +- w`` (`observer.trough.observation_equation`). In the design's geometry the reflected line passes the
tube's axis at

    y_A = P_y - (y_camera - P_y) R_a / R_c,

with R_a and R_c the distances across the trough to the axis and to the camera. It shows nothing where y_A lies beyond
the tube's end or at a support, or where the receiver itself is between camera and mirror.
"""

from dataclasses import dataclass

import numpy as np

from heliogauge.doubts import Doubt, Severity
from heliogauge.flags import SampleFlag
from heliogauge.validate import BoolArray, FlagArray, FloatArray
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector

#: Rows that are looked at; what is visible changes smoothly along the trough [m].
_ROW_STEP_M = 0.1
#: A photo within so many usual distances between photos, in angle, is where the edge would be seen.
_SPACINGS = 1.5
#: The least such distance: a mirror bent that much more than its neighbourhood changes nothing of the geometry [rad].
_LEAST_SPACING_RAD = 4e-3
#: Columns further apart than this belong to different parts of the aperture; so many parts are named [m].
_BETWEEN_M, _INTERVALS = 0.1, 3
#: Less of the mirror is not worth a sentence.
WORTH_SAYING_SHARE = 0.005
#: A gap in the cameras' path is so many times as wide as usual.
_GAP_TIMES = 2.5


@dataclass(frozen=True, slots=True, eq=False)
class Visibility:
    """What the cameras can see of the tube by way of each node.

    flags (r, nx): Reasons (`heliogauge.flags.SampleFlag`) for nodes that cannot be measured; 0 elsewhere.
    seeable (r, nx): Nodes by which a camera on this path, were it long enough, would see an edge of the tube.
    camera_from_x_m, camera_to_x_m: Where cameras would have to be, at their height, to see the tube by way of the
        whole aperture [m].
    """

    flags: FlagArray
    seeable: BoolArray
    camera_from_x_m: float
    camera_to_x_m: float


@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    """Geometry across the trough of nodes, arrays of one shape, that of some rows of the mirror or (m,)."""

    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray
    axis_x_m: FloatArray
    axis_z_m: FloatArray
    reach_m: FloatArray
    centre_rad: FloatArray
    half_rad: FloatArray

    def chosen(self, which: BoolArray) -> "_Nodes":
        """Return some of them."""
        return _Nodes(*(getattr(self, name)[which] for name in self.__slots__))


def visibility(
    nodes_m: tuple[FloatArray, FloatArray],
    eyes_m: FloatArray,
    collector: Collector,
    absorber: AbsorberPath,
    theta_r_rad: FloatArray,
) -> Visibility:
    """Return which nodes of the mirror can show the tube's edges.

    Shapes: eyes_m (n, 3).
    nodes_m: Ascending columns and rows [m].
    theta_r_rad (r, nx): Slope error as far as known; NaN counts as none [rad].
    Returns: Reasons, and where the camera would have to go.
    """
    x, y = nodes_m
    step = float(y[1] - y[0]) if y.size > 1 else 1.0
    rows = np.unique(np.append(np.arange(0, y.size, max(1, round(_ROW_STEP_M / step))), y.size - 1))
    nodes = _geometry(x, y[rows], collector, absorber, np.nan_to_num(theta_r_rad[rows]))
    covered, shows, open_to = np.zeros((3, rows.size, x.size), dtype=bool)
    slack = max(_LEAST_SPACING_RAD, _SPACINGS * _spacing(eyes_m))
    for eye in eyes_m:
        to_x, to_z = eye[0] - nodes.x_m, eye[2] - nodes.z_m
        beside = np.arctan2(to_x, to_z) - nodes.centre_rad
        meets = np.abs(np.abs(beside) - nodes.half_rad) < slack
        covered |= meets
        # A photo shows the tube in a tenth of the mirror.
        own, to_x, to_z = nodes.chosen(meets), to_x[meets], to_z[meets]
        distance = np.hypot(to_x, to_z)
        passing = own.y_m - (eye[1] - own.y_m) * own.reach_m / distance
        tube = _is_tube(passing, collector)
        shows[meets] |= tube
        open_to[meets] |= tube & ~_is_behind(own, to_x, to_z, distance, collector)
    flags = np.zeros(covered.shape, dtype=np.uint32)
    flags[~open_to & shows] = np.uint32(SampleFlag.BEHIND_TUBE)
    flags[covered & ~shows] = np.uint32(SampleFlag.BEYOND_TUBE)
    flags[~covered] = np.uint32(SampleFlag.NOT_COVERED)
    needed = _needed(nodes, eyes_m)
    nearest = np.abs(y[:, None] - y[rows]).argmin(axis=1)
    return Visibility(flags[nearest], (open_to | ~covered)[nearest], *needed)


def _geometry(
    x_m: FloatArray, y_m: FloatArray, collector: Collector, absorber: AbsorberPath, theta_r_rad: FloatArray
) -> _Nodes:
    """Return where nodes lie and under which angles they show the tube's middle and its edges."""
    x, y = np.meshgrid(x_m, y_m)
    focal = collector.focal_length_m
    z = x**2 / (4 * focal)
    axis_x, axis_z = absorber.at(y)
    reach = np.hypot(axis_x - x, axis_z - z)
    centre = 2 * theta_r_rad + np.arctan2(-x, focal - z) - np.arctan2(axis_x - x, axis_z - z)
    half = np.arcsin(np.minimum(collector.absorber_diameter_m / 2 / reach, 1.0))
    return _Nodes(x, y, z, axis_x, axis_z, reach, centre, half)


def _spacing(eyes_m: FloatArray) -> float:
    """Return the usual angle between neighbouring photos, seen from the middle of the mirror [rad]."""
    angle = np.sort(np.arctan2(eyes_m[:, 0], eyes_m[:, 2]))
    return float(np.median(np.diff(angle))) if angle.size > 1 else 0.0


def _is_tube(passing_y_m: FloatArray, collector: Collector) -> BoolArray:
    """Return whether there is bare tube where the lines pass it."""
    tube = np.abs(passing_y_m) < collector.length_m / 2
    for support in collector.support_y_m:
        tube &= np.abs(passing_y_m - support) > collector.support_width_m / 2
    return np.asarray(tube)


def _is_behind(
    nodes: _Nodes, to_x: FloatArray, to_z: FloatArray, distance: FloatArray, collector: Collector
) -> BoolArray:
    """Return whether the receiver is between the camera and the node."""
    beside = (nodes.axis_x_m - nodes.x_m) * to_z - (nodes.axis_z_m - nodes.z_m) * to_x
    return np.asarray(np.abs(beside) < collector.receiver_diameter_m / 2 * distance)


def _needed(nodes: _Nodes, eyes_m: FloatArray) -> tuple[float, float]:
    """Return between which x cameras would see the middle of the tube by way of all nodes [m]."""
    height = float(np.median(eyes_m[:, 2]))
    place = nodes.x_m + (height - nodes.z_m) * np.tan(nodes.centre_rad)
    return float(np.percentile(place, 1)), float(np.percentile(place, 99))


def coverage_doubt(found: Visibility, x_m: FloatArray, aperture: BoolArray, eyes_m: FloatArray) -> Doubt | None:
    """Say which part of the aperture the cameras' path leaves out, and where to fly.

    Shapes: x_m (nx,), eyes_m (n, 3).
    aperture (r, nx): Nodes on panels.
    Returns: None where less than 1 % of the mirror is left out.
    """
    missing = aperture & ((found.flags & np.uint32(SampleFlag.NOT_COVERED)) > 0)
    share = int(np.count_nonzero(missing)) / max(int(np.count_nonzero(aperture)), 1)
    if share < 0.01:
        return None
    columns = x_m[missing.sum(axis=0) > 0.5 * np.maximum(aperture.sum(axis=0), 1)]
    eyes_x = np.sort(eyes_m[:, 0])
    steps = np.diff(eyes_x)
    gap = int(np.argmax(steps)) if steps.size else 0
    gaps = f", {steps[gap]:.2f} m apart at x = {eyes_x[gap]:.2f} to {eyes_x[gap + 1]:.2f} m" if steps.size else ""
    gaps = gaps if steps.size and steps[gap] > _GAP_TIMES * np.median(steps) else ""
    return Doubt(
        "mirror_not_covered",
        f"no photo shows an edge of the absorber's reflection on {100 * share:.0f} % of the mirror "
        f"({_intervals(columns)}): the cameras were between x = {eyes_x[0]:.2f} and {eyes_x[-1]:.2f} m at "
        f"{np.median(eyes_m[:, 2]):.1f} m{gaps}; fly from x = {found.camera_from_x_m:.2f} to "
        f"{found.camera_to_x_m:.2f} m without gaps",
        {
            "not_covered_share": share,
            "fly_from_x_m": float(found.camera_from_x_m),
            "fly_to_x_m": float(found.camera_to_x_m),
        },
    )


def beyond_tube_doubt(found: Visibility, aperture: BoolArray, collector: Collector, eyes_m: FloatArray) -> Doubt | None:
    """Say where to fly for what shows no tube because its reflection lies beyond the tube's ends or at supports.

    Shapes: aperture (r, nx), eyes_m (n, 3).
    """
    missing = aperture & ((found.flags & np.uint32(SampleFlag.BEYOND_TUBE)) > 0)
    share = int(np.count_nonzero(missing)) / max(int(np.count_nonzero(aperture)), 1)
    if share <= WORTH_SAYING_SHARE:
        return None
    text = beyond_tube_text(share, collector, float(np.median(eyes_m[:, 2])))
    return Doubt("mirror_beyond_tube", text, {"missing_share": share}, Severity.NOTE)


def beyond_tube_text(share: float, collector: Collector, height_m: float) -> str:
    """Say how much of the mirror shows what lies beyond the tube's ends or supports, and where to fly for it.

    share: Of the mirror.
    height_m: Of the cameras over the vertex [m].
    """
    half = collector.length_m / 2
    # A pass moves so far for a support's reflection to move by its width and a half.
    apart = 1.5 * collector.support_width_m * height_m / collector.focal_length_m
    beside = f", and two passes {apart:.1f} m apart see beside the supports" if collector.support_y_m.size else ""
    return (
        f"{100 * share:.1f} % of the mirror shows what lies beyond the tube's ends or receiver supports; passes at "
        f"y = {-half:.2f} and {half:.2f} m show the ends{beside}"
    )


def _intervals(columns_m: FloatArray) -> str:
    """Return the widest intervals of columns as text, in ascending order."""
    if columns_m.size == 0:
        return "scattered over the aperture"
    parts = np.split(columns_m, np.nonzero(np.diff(columns_m) > _BETWEEN_M)[0] + 1)
    widest = sorted(sorted(parts, key=np.ptp)[-_INTERVALS:], key=lambda part: float(part[0]))
    return "x = " + " and ".join(f"{part[0]:.2f} to {part[-1]:.2f}" for part in widest) + " m"


def seeable_shares(found: Visibility, aperture: BoolArray, valid: BoolArray) -> tuple[float, float]:
    """Return the share of the mirror that can show the tube, and how much of that was measured.

    aperture (r, nx): Nodes on panels.
    valid (r, nx): Nodes with a value.
    seeable_share, seeable_measured_share: Both between 0 and 1.
    """
    can = aperture & found.seeable
    count = max(int(np.count_nonzero(can)), 1)
    return count / max(int(np.count_nonzero(aperture)), 1), int(np.count_nonzero(can & valid)) / count
