"""What all touching lines of sight have in common: camera poses, where the tube is, how wide it looks.

Each mirror point is seen through both edges of the tube, by different photos. Half the sum of what they say is the
slope; half the difference is the width ``w = asin(a / R)`` of the tube as seen from there, R its distance. That width
says how the tube lies to the mirror, but other things change it too, and are unknowns beside it:

- the tube's place at its stations, known from its direct view, with that covariance;
- its radius;
- a displacement of all edges outward, and one for each photo, from blur, exposure and the way edges are located;
- the middle of the glass beside that of the tube: the glass turns a line that touches the metal by kappa while it is
  inside, so that with the tube d beside the middle of the glass and the line's direction u the tube looks wider by
  ``2 kappa u.d`` towards one side of the mirror and narrower towards the other (0.1 mm in 35 mm for d = 6 mm). Glass
  is straight between its bellows and the tube sags within it: what the tube's path says of that is known
  (`glass_widening_rad`), how each glass is mounted is not;
- the mean height of each panel, with the accuracy of its mounting as prior: a millimetre looks like 0.15 mrad of slope
  at the rim, which nothing separates from slope, and like 0.03 mrad of width, which many edges together do show.

What is left out of these comes back as wrong poses: with the glass 6 mm beside the tube they err by four times their
standard deviation, and slopes by 0.1 mrad.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.photo_edges.outward_edges import looks_rad_per_m
from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.slopes.panel_places import PanelPlaces
from observer.slopes.pose_modes import CameraModes
from observer.trough.absorber_path import AbsorberPath
from observer.trough.expectation import Expectation
from observer.trough.glass import count_receivers, glass_beside_tube, glass_ends, turned_rad
from observer.trough.observation_equation import Misfit, Sights, change_across, misfit

#: What the stated radius is good for, as a share of it.
_RADIUS_SHARE = 5e-3
#: How far the glass may be beside the tube [m].
_GLASS_M = 3e-3
#: How far edges may lie outward, in standard deviations of the noise of one: all of them (0.05 px at a noise of 0.025
#: px), and those of one photo beyond that. In ray-traced photos it is 0.003 to 0.006 px.
_OUTWARD, _OUTWARD_OF_PHOTO = 2.0, 0.4
#: Height by which derivatives are taken [m].
_LIFT_M = 1e-3
#: Unknowns of the tube beside its place and its glass: radius, displacement of all edges.
_TUBE_UNKNOWNS = 2


@dataclass(frozen=True, slots=True, eq=False)
class CommonUnknowns:
    """Unknowns that move many lines: poses, widths of photos, the tube's place, the tube itself, heights of panels.

    index (m, c): Unknowns that move each line; those of its photo come first.
    derivative (m, c): By how much [rad].
    covariance (k, k): Prior covariance of the unknowns about zero.
    n_photo: Number of unknowns that belong to single photos.
    n_stations: Stations of the tube whose place is unknown; 0 where it is held.
    units (2 + 2 g,): Of the tube's own unknowns: radius [m], edges outward [rad], x and z of each glass [m].
    steps (n, 6, MODES_PER_PHOTO): Step of each photo's pose (`RigidTransform.moved`) for one unit of its first
        unknowns [rad, m].
    height_unit_m: Unit of the panels' heights; 0 where they are held, and not among the unknowns [m].
    n_panels: Panels whose heights are unknowns; where their edges were seen, so many leans along the trough follow.
    mean (k,): What the unknowns are expected to be; none: zero.
    """

    index: IntArray
    derivative: FloatArray
    covariance: FloatArray
    n_photo: int
    n_stations: int
    units: FloatArray
    steps: FloatArray
    height_unit_m: float = 0.0
    n_panels: int = 0
    mean: FloatArray | None = None

    @property
    def expected_rad(self) -> FloatArray:
        """By how much each line is moved by what the unknowns are expected to be, shape (m,) [rad]."""
        if self.mean is None:
            return np.zeros(len(self.index))
        return np.asarray(np.einsum("mc,mc->m", self.derivative, self.mean[self.index]))

    @property
    def place(self) -> slice:
        """Unknowns that are the tube's place, x at all stations and z at all stations [m]."""
        return slice(self.n_photo, self.n_photo + 2 * self.n_stations)

    @property
    def radius(self) -> int:
        """Unknown that is the tube's radius, in its unit."""
        return self.n_photo + 2 * self.n_stations

    @property
    def is_place(self) -> BoolArray:
        """Which unknowns are the tube's place, shape (k,)."""
        which = np.zeros(len(self.covariance), dtype=bool)
        which[self.place] = True
        return which

    def place_as_slope(self, expected: Expectation, y_m: FloatArray, x_m: FloatArray) -> FloatArray:
        """Return by how much the tube's place looks like slope across: its theta_a is that of so much less slope.

        y_m, x_m: Rows and columns of nodes [m].
        Returns (r, n, 2 k): For each coordinate of the stations, x first; k is 0 where the tube is held [rad/m].
        """
        path, focal, k = expected.absorber, expected.collector.focal_length_m, self.n_stations
        found = np.zeros((y_m.size, x_m.size, 2 * k))
        if k == 0:
            return found
        axis_x, axis_z = path.at(y_m)
        to_x, to_z = axis_x[:, None] - x_m, axis_z[:, None] - x_m**2 / (4 * focal)
        # theta_r changes by -1 / (1 + slope^2) of a slope, theta_a by -to_z / (2 R^2) of x and to_x / (2 R^2) of z.
        scale = (1 + (x_m / (2 * focal)) ** 2) / (2 * (to_x**2 + to_z**2))
        before, share = path.shares(y_m)
        row = np.arange(y_m.size)
        for place, weight in ((before, 1 - share), (np.minimum(before + 1, k - 1), share)):
            found[row, :, place] += -weight[:, None] * to_z * scale
            found[row, :, k + place] += weight[:, None] * to_x * scale
        return found

    def panel_heights_m(self, common: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return by how much each panel is higher than its design, and the standard deviation.

        Shapes: common (k,), covariance (k, k).
        height_m, sigma_m (p,): In the order of `Collector.panel_index`; empty where heights are held [m].
        """
        own = slice(self.radius + self.units.size, self.radius + self.units.size + self.n_panels)
        sigma = np.sqrt(np.diagonal(covariance)[own])
        return self.height_unit_m * common[own], self.height_unit_m * sigma

    def moved_poses(
        self, poses: Sequence[RigidTransform], covariance: FloatArray, common: FloatArray, covariance_common: FloatArray
    ) -> tuple[tuple[RigidTransform, ...], FloatArray]:
        """Return the poses as the solution has them.

        Shapes: common (k,), covariance_common (k, k), covariance (n, 6, 6).
        poses: As they were before, ``cam_from_frame``.
        covariance (6 n, 6 n): Joint covariance of their steps before.

        A photo's unknowns m are combinations of its step s with unit covariance, so that ``s = S m + rest`` with S
        the `steps` and a rest that is independent of m. The edges give m and, but for what m has in common with it,
        not the rest: its expectation stays zero and its covariance ``P - S S^T``.
        """
        count, modes = len(self.steps), self.steps.shape[2]
        own = common[: count * modes].reshape(count, modes)
        numbers = np.arange(count * modes).reshape(count, modes)
        known = covariance_common[numbers[:, :, None], numbers[:, None, :]]
        before = covariance.reshape(count, 6, count, 6)[np.arange(count), :, np.arange(count)]
        gained = self.steps @ (np.eye(modes) - known) @ np.swapaxes(self.steps, 1, 2)
        after = before - 0.5 * (gained + np.swapaxes(gained, 1, 2))
        steps = np.einsum("nij,nj->ni", self.steps, own)
        return tuple(pose.moved(step) for pose, step in zip(poses, steps, strict=True)), after

    def moved(self, path: AbsorberPath, common: FloatArray, covariance: FloatArray) -> AbsorberPath:
        """Return the tube's path as the solution has it.

        Shapes: common (k,), covariance (k, k).
        Returns: The path; the same one where it was held.
        """
        if self.n_stations == 0:
            return path
        step, block = common[self.place], covariance[self.place, self.place]
        n = self.n_stations
        return replace(path, x_m=path.x_m + step[:n], z_m=path.z_m + step[n:], covariance_m2=0.5 * (block + block.T))


@dataclass(frozen=True, slots=True, eq=False)
class BesidePoses:
    """What moves lines besides the poses of their photos, arrays of m lines.

    expected: Collector and the tube's place.
    n_stations: Stations of the tube whose place is unknown; 0 where it has no variance, and is held.
    outward (m,): Change of the misfits where edges lie outward by one radian at the camera.
    unit_rad: Usual noise of an edge [rad].
    place: Coordinates of the tube's stations that move each line, and by how much.
    tube: The tube's own unknowns.
    lifted: Heights of panels.
    panels: How high the panels are by their own edges; None: as well as they are mounted.
    """

    expected: Expectation
    n_stations: int
    outward: FloatArray
    unit_rad: float
    place: tuple[IntArray, FloatArray]
    tube: "_Tube"
    lifted: "_Lifted"
    panels: PanelPlaces | None


def beside_poses(
    edges: ReflectionEdges,
    sights: Sights,
    found: Misfit,
    expected: Expectation,
    *,
    bend_per_m: FloatArray | float = 0.0,
    outward_rad: float = 0.0,
    panels: PanelPlaces | None = None,
) -> BesidePoses:
    """Collect what moves touching lines of sight besides the poses of their photos.

    found: Misfits and derivatives of these, with the design's slopes.
    bend_per_m (m,): Curvature across that the mirror has beside the design: an edge that lies outward stands where the
        slope is another one [1/m].
    outward_rad: How far all edges may lie outward together beside what blur does, 1 sigma, as where it is open how the
        photos are encoded [rad].
    """
    path, m = expected.absorber, edges.photo.size
    n_stations = path.n if np.diagonal(path.covariance_m2).any() else 0
    outward, unit = _outward(edges, sights, found, expected.collector.focal_length_m, bend_per_m)
    place = _place(found, sights, expected) if n_stations else (np.zeros((m, 0), dtype=np.intp), np.zeros((m, 0)))
    tube = _tube(found, sights, expected, outward, float(np.hypot(_OUTWARD * unit, outward_rad)))
    lifted = _lift_panels(sights, found, expected, None if panels is None else panels.lean_sigma)
    return BesidePoses(expected, n_stations, outward, unit, place, tube, lifted, panels)


def common_unknowns(
    beside: BesidePoses, photo: IntArray, modes: CameraModes, with_poses: FloatArray | None = None
) -> CommonUnknowns:
    """Collect what touching lines of sight have in common.

    photo (m,): Photo of each line.
    modes: The unknowns that stand for the poses.
    with_poses (2 k, 6 n): Covariance of the tube's place with the steps of the poses: wrong targets displace both.
    Returns: Index, derivatives and prior covariance.
    """
    path, collector, n_stations = beside.expected.absorber, beside.expected.collector, beside.n_stations
    place, tube, lifted, panels = beside.place, beside.tube, beside.lifted, beside.panels
    n_modes = len(modes.covariance)
    n_photo = n_modes + n_modes // modes.index.shape[1]
    first_tube = n_photo + 2 * n_stations
    first_panel = first_tube + tube.units.size
    index = np.column_stack(
        [modes.index, n_modes + photo, n_photo + place[0], first_tube + tube.unknown, first_panel + lifted.unknown]
    )
    of_photo = _OUTWARD_OF_PHOTO * beside.unit_rad * beside.outward
    derivative = np.column_stack([modes.derivative, of_photo, place[1], tube.derivative, lifted.derivative])
    covariance = np.eye(first_panel + lifted.n_unknowns)
    mean = None
    covariance[:n_modes, :n_modes] = modes.covariance
    if n_stations:
        # A micrometre keeps the matrix positive definite.
        covariance[n_photo:first_tube, n_photo:first_tube] = path.covariance_m2 + 1e-12 * np.eye(2 * path.n)
        if with_poses is not None:
            covariance[n_photo:first_tube, :n_modes] = modes.read(with_poses)
            covariance[:n_modes, n_photo:first_tube] = covariance[n_photo:first_tube, :n_modes].T
    if panels is not None and lifted.n_unknowns:
        units = np.repeat([collector.panel_height_sigma_m, panels.lean_sigma], collector.n_panels)
        mean = np.zeros(len(covariance))
        mean[first_panel:] = panels.value / units
        covariance[first_panel:, first_panel:] = panels.covariance / np.outer(units, units)
        covariance[first_panel:, :n_modes] = modes.read(panels.with_poses) / units[:, None]
        if n_stations and with_poses is not None:
            covariance[first_panel:, n_photo:first_tube] = panels.by_poses @ with_poses.T / units[:, None]
        covariance[:first_panel, first_panel:] = covariance[first_panel:, :first_panel].T
    return CommonUnknowns(
        index,
        np.nan_to_num(derivative, copy=False),
        covariance,
        n_photo,
        n_stations,
        tube.units,
        modes.steps,
        collector.panel_height_sigma_m,
        collector.n_panels if lifted.n_unknowns else 0,
        mean,
    )


class _Lifted(NamedTuple):
    """Which heights of panels move each line, and by how much, shapes (m, c); no column where heights are held."""

    unknown: IntArray
    derivative: FloatArray
    n_unknowns: int


def _lift_panels(sights: Sights, found: Misfit, expected: Expectation, lean_unit: float | None) -> _Lifted:
    """Lift each line's panel: the line of sight stays, and meets the panel at another place.

    lean_unit: Unit of the panels' slopes along the trough, by which their heights change; None: they are held.
    """
    collector, m = expected.collector, len(sights.side)
    unit, focal = collector.panel_height_sigma_m, collector.focal_length_m
    if unit == 0:
        return _Lifted(np.zeros((m, 0), dtype=np.intp), np.zeros((m, 0)), 0)
    x, y, _ = sights.points_m.T
    way = sights.points_m - sights.eyes_m
    points = sights.points_m + (_LIFT_M / (way[:, 2] - x / (2 * focal) * way[:, 0]))[:, None] * way
    slopes = points[:, 0] / (2 * focal), np.zeros(m)
    later = misfit(
        Sights(points, sights.eyes_m, sights.side), slopes, expected.absorber, collector.absorber_diameter_m / 2
    )
    by_height = (later.angle_rad - found.angle_rad) / _LIFT_M
    panel = collector.panel_index(x, y)
    derivative = np.where(panel >= 0, by_height, 0.0)
    own = np.maximum(panel, 0).astype(np.intp)
    if lean_unit is None:
        return _Lifted(own[:, None], unit * derivative[:, None], collector.n_panels)
    middles = 0.5 * (collector.panel_edges_y_m[1:] + collector.panel_edges_y_m[:-1])
    beside = y - middles[own // (len(collector.panel_edges_x_m) - 1)]
    both = np.column_stack([unit * derivative, lean_unit * beside * derivative])
    return _Lifted(np.column_stack([own, collector.n_panels + own]), both, 2 * collector.n_panels)


def _outward(
    edges: ReflectionEdges, sights: Sights, found: Misfit, focal_m: float, bend_per_m: FloatArray | float
) -> tuple[FloatArray, float]:
    """Return the change of the misfits where edges lie outward by one radian at the camera, and the usual noise [rad].

    Outward is towards the brighter side.
    """
    looks = looks_rad_per_m(sights.points_m, sights.eyes_m, focal_m)
    unit = float(np.median(edges.sigma_x_m * looks)) if edges.photo.size else 0.0
    return change_across(sights, found, focal_m, bend_per_m) * np.sign(edges.contrast) / looks, unit


def _place(found: Misfit, sights: Sights, expected: Expectation) -> tuple[IntArray, FloatArray]:
    """Return the coordinates of the tube's stations that move each line, and by how much, shapes (m, 4) or (m, 12).

    Where the tube hangs lower within its glass it looks wider, as much again as by its distance from the mirror: with
    the tube where the line passes, the middle of the glass beside it is known by the tube at both ends of the glass.
    By how much the tube leans between stations is held: of a change along the tube within metres that is a hundredth.
    """
    path, y_m = expected.absorber, np.nan_to_num(found.passing_y_m)
    by_place, by_glass = found.d_angle_d_absorber, np.stack(_by_glass(found, sights, expected), axis=1)
    parts = [(y_m, by_place)]
    ends = glass_ends(expected.collector, y_m)
    if ends is not None:
        share = ends.share[:, None]
        parts = [(y_m, by_place - by_glass), (ends.first_m, (1 - share) * by_glass), (ends.last_m, share * by_glass)]
    index, derivative = [], []
    for at_m, by in parts:
        before, share = path.shares(at_m)
        after = np.minimum(before + 1, path.n - 1)
        weights = np.column_stack([1 - share, share])
        index += [before, after, path.n + before, path.n + after]
        derivative += [weights * by[:, :1], weights * by[:, 1:]]
    return np.column_stack(index), np.column_stack(derivative)


class _Tube(NamedTuple):
    """Which of the tube's own unknowns move each line, and by how much, shapes (m, 4); the unit of each of them."""

    unknown: IntArray
    derivative: FloatArray
    units: FloatArray


def _tube(found: Misfit, sights: Sights, expected: Expectation, outward: FloatArray, spread_rad: float) -> _Tube:
    """Return what the tube's own unknowns do to each line.

    spread_rad: How far all edges may lie outward, 1 sigma [rad].
    """
    collector = expected.collector
    glasses = count_receivers(collector)
    of_tube = [_RADIUS_SHARE * collector.absorber_diameter_m / 2, spread_rad]
    units = np.array([*of_tube, *[_GLASS_M] * (2 * glasses)])
    receiver = glass_beside_tube(collector, expected.absorber, np.nan_to_num(found.passing_y_m)).receiver
    first = _TUBE_UNKNOWNS + 2 * receiver
    index = np.stack([np.zeros_like(first), np.ones_like(first), first, first + 1], axis=1)
    columns = np.stack([found.d_angle_d_radius, outward, *_by_glass(found, sights, expected)], axis=1)
    return _Tube(index, columns * units[index], units)


def _by_glass(found: Misfit, sights: Sights, expected: Expectation) -> tuple[FloatArray, FloatArray]:
    """Return by how much x and z of the middle of the glass, the tube held, move each line, shape (m,) [rad/m]."""
    axis_x, axis_z = expected.absorber.at(np.nan_to_num(found.passing_y_m))
    to_x, to_z = axis_x - sights.points_m[:, 0], axis_z - sights.points_m[:, 2]
    kappa = turned_rad(expected.collector, 1.0) / np.hypot(to_x, to_z)
    return kappa * to_x * found.d_angle_d_radius, kappa * to_z * found.d_angle_d_radius


def glass_widening_rad(found: Misfit, sights: Sights, expected: Expectation) -> FloatArray:
    """Return by how much glass that is straight between its bellows moves each line, as far as the tube's path says.

    found: Misfits and derivatives of these lines, with the design's slopes.
    Returns (m,): To be added to the misfits [rad].
    """
    beside = glass_beside_tube(expected.collector, expected.absorber, np.nan_to_num(found.passing_y_m))
    by_x, by_z = _by_glass(found, sights, expected)
    return np.asarray(np.nan_to_num(by_x * beside.x_m + by_z * beside.z_m))
