"""One frame of a series: dots, their numbers and slopes, with what the first frame has told."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.dots.facet_lattices import FacetLattice, lattices_of_facets
from deflectometry.dots.found_dots import FoundDots, find_dots, find_lattices
from deflectometry.dots.mark_evidence import MarkEvidence
from deflectometry.dots.origin import Sight, place_dots
from deflectometry.dots.pipeline.measure import PlacedPhoto
from deflectometry.dots.rim import BLURS
from deflectometry.pipeline.mean_normal import normal_angles_of
from deflectometry.pipeline.source_slopes import (
    MirrorPixels,
    SolvedSource,
    poses_of_facets,
    slopes_of_facets,
    solve_source,
)
from deflectometry.pose.mirror_outline import outline_distance_px
from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.dot_marks import DotMarks
from deflectometry.shape.pixel_slopes import SlopeImage
from deflectometry.shape.smooth_shape import tilt_of
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, rotation_between
from heliogauge.geometry.surfaces import Facet
from heliogauge.running.progress import SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.slopes.normal_angles import normal_angles
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.centers import REACH
from photogrammetry.targets import Polarity

#: Pixels around the mirror that are looked at with it.
_AROUND_PX = 8


@dataclass(frozen=True, slots=True, eq=False)
class FacetMotion(ShortRepr):
    """How one facet stands in a frame.

    normal (3,): Its mean normal in the camera's frame.
    sigma_noise_rad (2,): Of the normal in x and y, by the noise of the dots [rad].
    sigma_waves_rad (2,): Change of the normal when each dot shows the place of the next one, by waviness [rad].
    edges_rad (2,): Changes of the normal without the outermost dots at one edge; root of the sum of their squares over
        the four edges [rad].
    mean_squares_rad2 (2,): Means of the squares of the angles from the design [rad^2].
    edges_rad2 (2,): The same of these means as of the normal [rad^2].
    noise_rad (2,): Standard deviation of a slope by the noise of the dots, RMS [rad].
    count: Dots.
    """

    normal: FloatArray
    sigma_noise_rad: FloatArray
    sigma_waves_rad: FloatArray
    edges_rad: FloatArray
    mean_squares_rad2: FloatArray
    edges_rad2: FloatArray
    noise_rad: FloatArray
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class FrameSlopes(ShortRepr):
    """What one frame gives.

    pose: The aligned pose, cam_from_mirror.
    step_rad: Turn that moves the pattern by one dot [rad].
    normal_rad (2,): Angles of the mean normal in the screen's frame [rad].
    facets: The facets that were measured, by name.
    probability: Of the place in the pattern, that of the least sure lattice.
    """

    pose: RigidTransform
    normal_rad: FloatArray
    facets: Mapping[str, FacetMotion]
    probability: float
    step_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class KnownMirror(ShortRepr):
    """What the first frame has told.

    photo: Its photo with the places of its dots.
    pixels: Which facet each pixel sees.
    inside_px (h, w): How far each pixel is within the outline of its facet [px].
    slopes: Its smooth shape.
    polarity, marks: Of the pattern.
    step_rad: Turn of the mirror that moves the pattern by one dot [rad].
    """

    photo: PlacedPhoto
    pixels: MirrorPixels
    inside_px: FloatArray
    slopes: SolvedSource
    polarity: Polarity
    marks: DotMarks | None
    step_rad: float

    @classmethod
    def of(cls, photo: PlacedPhoto, polarity: Polarity, marks: DotMarks | None) -> "KnownMirror":
        """Measure the first frame.

        EstimationError: No facet shows the pattern.
        """
        ready, located = photo.ready, photo.located
        setup, source = ready.setup, photo.source
        pixels = MirrorPixels.of(source, setup, located)
        slopes = solve_source(source, setup, located, pixels, SilentProgress(), align=True)
        reach_px = 4.0 * max(one.dots.spacing_px for one in photo.lattices)
        inside = outline_distance_px(setup.camera, located.outline_pose, located.facets, reach_px)
        apart_m = np.linalg.norm((setup.cam_from_screen.inverse() @ slopes.solution.cam_from_mirror).translation_m)
        step_rad = 0.5 * float(source.screen.spacing_m.min() / apart_m)
        return cls(photo, pixels, inside, slopes, polarity, marks, step_rad)

    def measure(self, image_dn: npt.NDArray[Any], expected: RigidTransform, sigma_rad: float) -> FrameSlopes:
        """Measure a frame.

        image_dn (h, w): Grey values [DN].
        expected: The mirror's aligned pose.
        sigma_rad: How far its normal may be off in each direction [rad].
        EstimationError: Too few dots, no lattice, or no facet that shows the pattern.
        """
        ready, located, several = self.photo.ready, self.photo.located, len(self.photo.located.facets) > 1
        found = self._find(image_dn, several=several)
        if several:
            lattices = lattices_of_facets(found, self.pixels.facet_index, located.margin_px)
        else:
            lattices = tuple(FacetLattice(one, (0,), np.ones(len(one.number), dtype=np.bool_)) for one in found)
        sights = []
        for one in lattices:
            facet = located.facets[one.facets[0]]
            pose = UncertainPose(expected @ self._canted(facet), np.zeros((6, 6)))
            evidence = None if self.marks is None else MarkEvidence.of(one.dots, self.marks)
            sights.append(
                Sight(
                    one.dots,
                    ready.setup,
                    self.photo.source.screen,
                    pose,
                    facet,
                    on_facet=one.on_first,
                    name=facet.name,
                    marks=evidence,
                    mounting_rad=sigma_rad,
                )
            )
        placed = place_dots(sights, (self.photo.placed[0].turn,))
        source = replace(self.photo.source, dots=tuple(one.dots for one in placed), near_dots=None)
        slopes = solve_source(source, ready.setup, located, self.pixels, SilentProgress(), align=True)
        return frame_slopes(self, slopes, min(one.probability for one in placed))

    def _find(self, image_dn: npt.NDArray[Any], *, several: bool) -> tuple[FoundDots, ...]:
        """Find the dots of a frame that are clear of the mirror's edges."""
        rows, columns = (np.flatnonzero((self.inside_px > 0).any(axis=axis)) for axis in (1, 0))
        top, left = (max(int(one[0]) - _AROUND_PX, 0) for one in (rows, columns))
        part = np.ascontiguousarray(image_dn[top : rows[-1] + _AROUND_PX, left : columns[-1] + _AROUND_PX])
        whole = np.ones(part.shape, dtype=np.bool_)
        lattices = find_lattices(part, whole, self.polarity) if several else (find_dots(part, whole, self.polarity),)
        found = []
        for one in lattices:
            moved = replace(one, centers_px=one.centers_px + (left, top))
            # A dot that the photo's border cuts may have its middle beyond.
            last = np.array(self.inside_px.shape[::-1]) - 1
            column, row = np.clip(np.rint(moved.centers_px).astype(np.intp), 0, last).T
            radius = np.sqrt(np.linalg.eigvalsh(moved.outlines_px2)[:, 1])
            clear = self.inside_px[row, column] > REACH * radius + BLURS * moved.blur_px
            if np.count_nonzero(clear):
                found.append(moved.chosen(clear))
        if not found:
            raise EstimationError("no dot is clear of the mirror's edges")
        return tuple(found)

    def _canted(self, facet: Facet) -> RigidTransform:
        """Return the turn of the mirror's frame with which a facet of the design stands as in the first frame."""
        names = [one.facet.name for one in self.slopes.usable.samples]
        if facet.name not in names:
            return RigidTransform.identity()
        normal = _normal(facet, self.slopes.solution.tilt_rad[names.index(facet.name)])
        turn = rotation_between(_normal(facet, np.zeros(2)), normal)
        own = facet.ensemble_from_facet
        pivot = np.append(facet.reference_point_m, 0.0)
        return own @ RigidTransform(turn, pivot - turn @ pivot) @ own.inverse()


def _normal(facet: Facet, tilt_rad: FloatArray) -> FloatArray:
    """Return the normal at a facet's reference point, tilted against its design, (3,)."""
    design = np.array([float(slope) for slope in facet.design.gradient(*facet.reference_point_m)])
    normal = np.append(-(design + tilt_rad), 1.0)
    return np.asarray(normal / np.linalg.norm(normal))


def frame_slopes(known: KnownMirror, slopes: SolvedSource, probability: float) -> FrameSlopes:
    """Return what slopes say of mirror and facets."""
    facets = {one.name: one for one in known.photo.located.facets}
    found = {}
    setup, usable, solution = known.photo.ready.setup, slopes.usable, slopes.solution
    poses = poses_of_facets(usable, solution)
    images = slopes_of_facets(setup, slopes.screen_map, slopes.facet_index, usable, solution)
    for number, (name, image) in enumerate(images.items()):
        normal = poses[name].rotate(_normal(facets[name], solution.tilt_rad[number]))
        found[name] = facet_motion(facets[name], image, np.asarray(normal))
    pose = solution.cam_from_mirror
    screen_from_mirror = setup.cam_from_screen.inverse() @ pose
    return FrameSlopes(pose, normal_angles_of(screen_from_mirror), found, probability, known.step_rad)


def facet_motion(facet: Facet, image: SlopeImage, normal: FloatArray) -> FacetMotion:
    """Return how a facet stands, and what moves that when the pattern moves over it.

    image: Its slopes at the dots, in the rows and columns of their lattice.
    normal (3,): Its mean normal in the camera's frame.
    """
    seen = np.isfinite(image.slope_x) & np.isfinite(image.slope_y)
    x, y = image.x_m[seen], image.y_m[seen]
    slopes, design = np.stack([image.slope_x[seen], image.slope_y[seen]]), np.stack(facet.design.gradient(x, y))
    angles = normal_angles(*slopes, *design)
    place = np.stack([x, y], axis=1) - facet.reference_point_m
    u, v = place.T / np.abs(place).max()
    terms = np.column_stack([np.ones_like(u), u, v, u * u, u * v, v * v])
    rest = np.full((2, *seen.shape), np.nan)
    rest[:, seen] = angles - (terms @ np.linalg.lstsq(terms, angles.T, rcond=None)[0]).T
    noise = np.array([float(np.sqrt(np.mean(one[seen] ** 2))) for one in (image.sigma_x, image.sigma_y)])
    steps = np.concatenate([np.diff(rest, axis=axis).reshape(2, -1) for axis in (1, 2)], axis=1)
    # Of a dot and the next one, without their noise.
    waves = np.maximum(np.nanmean(steps**2, axis=1) - 2.0 * noise**2, 0.0)
    # The normal is the constant term of slopes that are linear in both places.
    weight = np.linalg.inv(terms[:, :3].T @ terms[:, :3])[0, 0]
    squares = angles**2
    tilts, means = [], []
    for kept in (np.ones(len(x), dtype=np.bool_), *(~one[seen] for one in _outermost(seen))):
        tilts.append(tilt_of(facet, np.stack([x, y])[:, kept], (slopes - design)[:, kept]))
        means.append(squares[:, kept].mean(axis=1))
    without, without_squares = np.array(tilts[1:]) - tilts[0], np.array(means[1:]) - means[0]
    return FacetMotion(
        normal,
        np.sqrt(weight) * noise,
        np.sqrt(weight * waves),
        np.sqrt(np.sum(without**2, axis=0)),
        means[0],
        np.sqrt(np.sum(without_squares**2, axis=0)),
        noise,
        len(x),
    )


def _outermost(seen: BoolArray) -> Iterator[BoolArray]:
    """Yield the outermost dots at each of the four edges of a lattice (h, w)."""
    for axis in (0, 1):
        for side in (seen, np.flip(seen, axis)):
            first = seen & False
            np.put_along_axis(first, np.expand_dims(side.argmax(axis=axis), axis), True, axis)
            first &= side
            yield first if side is seen else np.flip(first, axis)
