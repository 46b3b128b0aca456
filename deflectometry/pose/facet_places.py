"""How well the place of each facet of an ensemble is known: as stated, or as its own outline in the image tells it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deflectometry.pose.adjust_pose import MIN_PROBABILITY, OutlineRows, PoseObservations
from heliogauge.adjust.chi_square import chi_square_cdf
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import FloatArray

#: How far the normal of a good mirror, or of a facet, may be off that of its outline, 1 sigma [rad]: what mounts allow.
MOUNTING_RAD = 3e-3


@dataclass(frozen=True, slots=True, eq=False)
class FacetPlace:
    """How far one facet may be from where the ensemble has it.

    covariance_m2 (3, 3): Of its place in the ensemble's frame.
    offset_m (3,), covariance_offset_m2 (3, 3): How far it is from its place according to its outline, in that frame,
        and the covariance of that; NaN where no outline was found.
    pose_by_place (6, 3): Step of the ensemble's pose, as `RigidTransform.moved` takes it, that the same outlines give
        after a step of the place; zero for a pose that does not come from the outlines.
    """

    name: str
    covariance_m2: FloatArray
    offset_m: FloatArray
    covariance_offset_m2: FloatArray
    pose_by_place: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FacetPlaces:
    """The places of all facets of an ensemble, and what contradicts them."""

    places: tuple[FacetPlace, ...] = ()
    doubts: tuple[Doubt, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class OutlinedEnsemble:
    """Facets whose outlines were followed in an image.

    camera, facets, observations: The camera, all facets, and their edges in the image.
    pose, covariance (6, 6): Pose whose outlines lie on the edges, cam_from_mirror, and its covariance for steps of
        `RigidTransform.moved`.
    gives_pose: The mirror's pose was found from these edges, and follows them.
    """

    camera: Camera
    facets: Sequence[Facet]
    observations: PoseObservations
    pose: RigidTransform
    covariance: FloatArray
    gives_pose: bool


def facet_places(ensemble: OutlinedEnsemble, stated_m: Sequence[FloatArray | None]) -> FacetPlaces:
    """Return how well the place of each facet is known.

    stated_m: Standard deviations (3,) of each facet's place along the axes of the ensemble; None where none is stated.

    Facets are bolted to a frame, and the canting of each is found from where it is: 2 mm along the line of sight are
    0.04 mrad before a screen at 10 m. A place without a stated sigma is known as its own outline knows it: by the size
    of the facet's image along the line of sight, by the place of its image across. The value stays as stated. A place
    that the outline contradicts is named, and the distance between the two counts as uncertainty.
    """
    if len(ensemble.facets) < 2:
        return FacetPlaces()
    edges = ensemble.observations.rows_of_facets(ensemble.camera, ensemble.pose)
    alone = [_Alone.of(ensemble, edges, number) for number in range(len(ensemble.facets))]
    places, off, unstated = [], [], []
    for facet, one, sigma_m in zip(ensemble.facets, alone, stated_m, strict=True):
        offset, seen = one.offset
        covariance = seen if sigma_m is None else np.diag(sigma_m**2)
        if sigma_m is None:
            unstated.append(float(np.sqrt(np.linalg.eigvalsh(seen)[-1])))
        total = seen if sigma_m is None else seen + covariance
        probability = 1.0 - chi_square_cdf(float(offset @ np.linalg.solve(total, offset)), 3.0)
        if probability < MIN_PROBABILITY / len(ensemble.facets):
            off.append((facet.name, offset, probability))
            covariance = covariance + np.outer(offset, offset)
        places.append(FacetPlace(facet.name, covariance, offset, seen, one.pose_by_place))
    return FacetPlaces(tuple(places), gather_doubts(_off_place(off), _not_stated(unstated)))


@dataclass(frozen=True, slots=True, eq=False)
class _Alone:
    """What the edges of one facet say of its own place and turn, held against the pose of the ensemble.

    residuals (n,), derivatives (n, 6): Of its edges, by a turn about its own middle and a step of its place in the
        camera's frame; in sigma.
    known (6, 6): Inverse covariance of turn and place beforehand.
    pose_by_place (6, 3): As in `FacetPlace`.
    to_cam (3, 3): Rotation from the ensemble's frame to the camera's.
    """

    residuals: FloatArray
    derivatives: FloatArray
    known: FloatArray
    pose_by_place: FloatArray
    to_cam: FloatArray

    @classmethod
    def of(cls, ensemble: OutlinedEnsemble, outline: OutlineRows, number: int) -> "_Alone":
        facet, to_cam = ensemble.facets[number], ensemble.pose.rotation
        rows, own = outline.derivatives[outline.facet == number], outline.residuals[outline.facet == number]
        pivot = to_cam @ facet.ensemble_from_facet.apply(np.append(facet.reference_point_m, 0.0))
        # Turns about the facet's own middle: those about the ensemble's origin would move it.
        about = np.hstack([rows[:, :3] + rows[:, 3:] @ skew(pivot), rows[:, 3:]])
        known = np.zeros((6, 6))
        known[:3, :3] = np.linalg.inv(ensemble.covariance[:3, :3] + MOUNTING_RAD**2 * np.eye(3))
        # A facet that is half its size away from its place would be taken for another one.
        known[3:, 3:] = np.eye(3) / (0.5 * float(np.ptp(facet.outline_m, axis=0).max())) ** 2
        follows = np.zeros((6, 3))
        if ensemble.gives_pose:
            by_pose = ensemble.observations.outline_rows(ensemble.camera, ensemble.pose)
            mine = by_pose.derivatives[by_pose.facet == number]
            follows = -ensemble.covariance @ mine.T @ mine[:, 3:] @ to_cam
        return cls(own, about, known, follows, to_cam)

    @property
    def offset(self) -> tuple[FloatArray, FloatArray]:
        """How far the facet is from its place in the ensemble's frame, (3,), and the covariance of that, (3, 3)."""
        covariance = np.linalg.inv(self.derivatives.T @ self.derivatives + self.known)
        step = -covariance @ self.derivatives.T @ self.residuals
        return self.to_cam.T @ step[3:], self.to_cam.T @ covariance[3:, 3:] @ self.to_cam


def stated_places(facets: Sequence[Facet], stated_m: Sequence[FloatArray | None]) -> FacetPlaces:
    """Return how well the places of facets are known whose outlines were not found, before a pose that is given.

    Where none is stated either, half the size of a facet: farther off it would be taken for another one.
    """
    places = []
    for facet, sigma_m in zip(facets, stated_m, strict=True):
        half_m = 0.5 * float(np.ptp(facet.outline_m, axis=0).max())
        known = np.full(3, half_m) if sigma_m is None else sigma_m
        nothing = np.full((3, 3), np.nan)
        places.append(FacetPlace(facet.name, np.diag(known**2), nothing[0], nothing, np.zeros((6, 3))))
    return FacetPlaces(tuple(places))


def _off_place(off: Sequence[tuple[str, FloatArray, float]]) -> Doubt | None:
    """Return a doubt where outlines say that facets are elsewhere."""
    if not off:
        return None
    named = "; ".join(
        f"{name} by ({', '.join(f'{1e3 * one:+.1f}' for one in offset)}) mm" for name, offset, _ in off[:6]
    )
    more = f"; and {len(off) - 6} more" if len(off) > 6 else ""
    farthest = max(float(np.linalg.norm(offset)) for _, offset, _ in off)
    return Doubt(
        "facet_off_its_place",
        f"{len(off)} facets are not where the ensemble has them, according to their outlines in the image (x, y, z of "
        f"the ensemble's frame): {named}{more}. Their canting is found for the stated places, and its sigma contains "
        "the distance; check position_m and outline_m of these facets, and that nothing covers them",
        {"facets_count": len(off), "farthest_m": farthest, "agreement_probability": min(one[2] for one in off)},
    )


def _not_stated(sigmas_m: Sequence[float]) -> Doubt | None:
    """Return a note where places are known from outlines only."""
    if not sigmas_m:
        return None
    return Doubt(
        "facet_places_from_outlines",
        f"no sigma is given for the places of {len(sigmas_m)} facets: counted as known no better than the outlines in "
        f"the image know them, up to {1e3 * max(sigmas_m):.1f} mm, so that canting is less sure than it could be; "
        "state [mirror] sigma_facet_position_mm",
        {"facets_count": len(sigmas_m), "sigma_m": max(sigmas_m)},
        Severity.NOTE,
    )
