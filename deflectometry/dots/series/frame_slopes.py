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
from deflectometry.dots.series.turn_shares import turn_shares
from deflectometry.pipeline.mean_normal import normal_angles_of
from deflectometry.pipeline.result import Result
from deflectometry.pipeline.source_slopes import (
    MirrorPixels,
    SolvedSource,
    poses_of_facets,
    slopes_of_facets,
    solve_source,
)
from deflectometry.pose.find_pose import LocatedMirror
from deflectometry.pose.mirror_outline import outline_distance_px
from deflectometry.pose.pose_observations import UncertainPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.dot_marks import DotMarks
from deflectometry.shape.pixel_slopes import SlopeImage
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform, rotation_between
from heliogauge.geometry.surfaces import Facet
from heliogauge.running.progress import SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.slopes.normal_angles import normal_angles
from heliogauge.validate import BoolArray, FloatArray, IntArray
from photogrammetry.centers import REACH
from photogrammetry.targets import Polarity

#: Pixels around the mirror that are looked at with it.
_AROUND_PX = 8


@dataclass(frozen=True, slots=True, eq=False)
class FacetMotion(ShortRepr):
    """How one facet stands in a frame.

    facet: Itself.
    cam_from_facet: Its pose, in the mirror's aligned pose.
    tilt_rad (2,): Tilt of its mean normal against the design there [rad].
    rows_columns (n, 2): Place of each dot in the lattice.
    places_m (2, n): Where the facet shows each dot [m].
    slopes (2, n): Slopes there minus the design's [rad].
    mean_squares_rad2 (2,): Means of the squares of the angles from the design [rad^2].
    edges_rad2 (2,): Changes of these means without the outermost dots at one edge; root of the sum of their squares
        over the four edges [rad^2].
    noise_rad (2,): Standard deviation of a slope by the noise of the dots, RMS [rad].
    """

    facet: Facet
    cam_from_facet: RigidTransform
    tilt_rad: FloatArray
    rows_columns: IntArray
    places_m: FloatArray
    slopes: FloatArray
    mean_squares_rad2: FloatArray
    edges_rad2: FloatArray
    noise_rad: FloatArray

    @property
    def count(self) -> int:
        """Dots."""
        return len(self.rows_columns)

    def normal(self, tilt_rad: FloatArray) -> FloatArray:
        """Return the mean normal in the camera's frame when the facet's tilt against the design is this one, (3,)."""
        return np.asarray(self.cam_from_facet.rotate(_normal(self.facet, tilt_rad)))


@dataclass(frozen=True, slots=True, eq=False)
class FrameSlopes(ShortRepr):
    """What one frame gives.

    pose: The aligned pose, cam_from_mirror.
    step_rad: Turn that moves the pattern by one dot [rad].
    turn_shares (n, 2, 2): What one sigma of each input adds to a turn, as a multiple of it.
    normal_rad (2,): Angles of the mean normal in the screen's frame [rad].
    facets: The facets that were measured, by name.
    probability: Of the place in the pattern, that of the least sure lattice.
    """

    pose: RigidTransform
    normal_rad: FloatArray
    facets: Mapping[str, FacetMotion]
    probability: float
    step_rad: float
    turn_shares: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class KnownMirror(ShortRepr):
    """What the first frame has told.

    photo: Its photo with the places of its dots.
    setup, located: Camera, field and pose as they were measured by it.
    pixels: Which facet each pixel sees.
    inside_px (h, w): How far each pixel is within the outline of its facet [px].
    slopes: Its smooth shape.
    polarity, marks: Of the pattern.
    step_rad: Turn of the mirror that moves the pattern by one dot [rad].
    turn_shares (n, 2, 2): What one sigma of each input adds to a turn, as a multiple of it.
    """

    photo: PlacedPhoto
    setup: Setup
    located: LocatedMirror
    pixels: MirrorPixels
    inside_px: FloatArray
    slopes: SolvedSource
    polarity: Polarity
    marks: DotMarks | None
    step_rad: float
    turn_shares: FloatArray

    @classmethod
    def of(cls, photo: PlacedPhoto, result: Result, polarity: Polarity, marks: DotMarks | None) -> "KnownMirror":
        """Measure the first frame as the others will be.

        result: Of the first frame by itself: the outline is found best where its dots are known.
        EstimationError: No facet shows the pattern.
        """
        setup, located, source = result.setup, result.evaluation.located, photo.source
        pixels = MirrorPixels.of(source, setup, located)
        slopes = solve_source(source, setup, located, pixels, SilentProgress(), align=True)
        reach_px = 4.0 * max(one.dots.spacing_px for one in photo.lattices)
        inside = outline_distance_px(setup.camera, located.outline_pose, located.facets, reach_px)
        apart_m = np.linalg.norm((setup.cam_from_screen.inverse() @ slopes.solution.cam_from_mirror).translation_m)
        step_rad = 0.5 * float(source.screen.spacing_m.min() / apart_m)
        shares = turn_shares(setup, located.pose, slopes)
        return cls(photo, setup, located, pixels, inside, slopes, polarity, marks, step_rad, shares)

    def measure(self, image_dn: npt.NDArray[Any], expected: RigidTransform, sigma_rad: float) -> FrameSlopes:
        """Measure a frame.

        image_dn (h, w): Grey values [DN].
        expected: The mirror's aligned pose.
        sigma_rad: How far its normal may be off in each direction [rad].
        EstimationError: Too few dots, no lattice, or no facet that shows the pattern.
        """
        setup, located, several = self.setup, self.located, len(self.located.facets) > 1
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
                    setup,
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
        slopes = solve_source(source, setup, located, self.pixels, SilentProgress(), align=True)
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
    facets = {one.name: one for one in known.located.facets}
    setup, usable, solution = known.setup, slopes.usable, slopes.solution
    poses = poses_of_facets(usable, solution)
    images = slopes_of_facets(setup, slopes.screen_map, slopes.facet_index, usable, solution)
    found = {
        name: facet_motion(facets[name], poses[name], image, solution.tilt_rad[number])
        for number, (name, image) in enumerate(images.items())
    }
    pose = solution.cam_from_mirror
    screen_from_mirror = setup.cam_from_screen.inverse() @ pose
    return FrameSlopes(
        pose, normal_angles_of(screen_from_mirror), found, probability, known.step_rad, known.turn_shares
    )


def facet_motion(facet: Facet, cam_from_facet: RigidTransform, image: SlopeImage, tilt_rad: FloatArray) -> FacetMotion:
    """Return how a facet stands, and what moves its RMS when the pattern moves over it.

    image: Its slopes at the dots, in the rows and columns of their lattice.
    tilt_rad (2,): Tilt of its mean normal against the design [rad].
    """
    seen = np.isfinite(image.slope_x) & np.isfinite(image.slope_y)
    places = np.stack([image.x_m[seen], image.y_m[seen]])
    slopes, design = np.stack([image.slope_x[seen], image.slope_y[seen]]), np.stack(facet.design.gradient(*places))
    squares = normal_angles(*slopes, *design) ** 2
    noise = np.array([float(np.sqrt(np.mean(one[seen] ** 2))) for one in (image.sigma_x, image.sigma_y)])
    means = [squares.mean(axis=1), *(squares[:, ~one[seen]].mean(axis=1) for one in _outermost(seen))]
    without = np.array(means[1:]) - means[0]
    return FacetMotion(
        facet,
        cam_from_facet,
        tilt_rad,
        np.argwhere(seen),
        places,
        slopes - design,
        means[0],
        np.sqrt(np.sum(without**2, axis=0)),
        noise,
    )


def _outermost(seen: BoolArray) -> Iterator[BoolArray]:
    """Yield the outermost dots at each of the four edges of a lattice (h, w)."""
    for axis in (0, 1):
        for side in (seen, np.flip(seen, axis)):
            first = seen & False
            np.put_along_axis(first, np.expand_dims(side.argmax(axis=axis), axis), True, axis)
            first &= side
            yield first if side is seen else np.flip(first, axis)
