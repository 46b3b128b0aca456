"""A pose that was measured otherwise, held against the mirror's outline in the image."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deflectometry.pose.adjust_pose import PoseObservations, observed
from deflectometry.pose.mirrors_in_image import find_mirrors
from deflectometry.pose.outline_edges import OutlineFit, OutlineSearch, edge_margin_px
from deflectometry.pose.pose_observations import Knowledge, KnownPoints, UncertainPose
from deflectometry.pose.start_poses import mirror_regions
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import BoolArray, Float32Array

#: A sharp image: half a pixel's diagonal is what a pixel needs to lie wholly on the mirror.
SHARP_MARGIN_PX = 0.5 * float(np.sqrt(2.0))
#: Offsets of the outline beyond this many of their sigmas are a doubt, and those beyond this share of the edge's width.
_OFF_SIGMAS = 3.0
_OFF_WIDTH = 0.2
#: A fit whose corners are farther off the given pose than this share of a facet follows other edges than the mirror's.
_FARTHEST = 0.1


@dataclass(frozen=True, slots=True)
class OutlineCheck:
    """How a given pose fits the image.

    outline_pose: Pose whose outline lies on the edges in the image: defines which pixels see the mirror, not where the
        mirror is.
    margin_px: Distance to the outline below which a pixel may mix the mirror with its surroundings [px].
    residual_rms_px: RMS distance of the projected outline from the edges; NaN where no edges were found [px].
    edge_width_px: Width of the edges; NaN where none were found [px].
    doubt: The outline lies off the edges by more than pose and image allow, or could not be compared.
    scatter_px: RMS distance of the edges from the outline of `outline_pose`; 0 where none were found [px].
    observations: The edges that were found.
    """

    outline_pose: RigidTransform
    margin_px: float
    residual_rms_px: float
    edge_width_px: float = float("nan")
    doubt: Doubt | None = None
    scatter_px: float = 0.0
    observations: PoseObservations | None = None


def check_given_pose(
    image_dn: Float32Array,
    camera: Camera,
    facets: Sequence[Facet],
    given: UncertainPose,
    clutter: BoolArray | None = None,
    knowledge: Knowledge | None = None,
) -> OutlineCheck:
    """Look where the edges of a mirror with a given pose really are, and how wide.

    image_dn (h, w): Modulation of the fringes, or bright minus dark [DN].
    clutter (h, w): Where something else may be taken for an edge, or hides it.
    knowledge: How well the outline is known.
    Returns: The pose and margin for the mask, and how far the outline of the given pose is off the edges.
    """
    pose = given.cam_from_mirror
    image = np.nan_to_num(np.ascontiguousarray(image_dn, dtype=np.float32), posinf=0.0, neginf=0.0)
    try:
        found = find_mirrors(image)
        regions = mirror_regions(found, len(facets))
        facet_px = float(np.sqrt(np.median([region.area_px for region in regions])))
        fit = OutlineSearch(image, camera, facets, found.noise_dn, facet_px, clutter).follow(pose, KnownPoints())
        _refuse_strayed(fit, camera, facets, pose, facet_px)
    except EstimationError as error:
        doubt = Doubt(
            "given_pose_unchecked", f"the given pose of the mirror could not be held against the image: {error}"
        )
        return OutlineCheck(pose, SHARP_MARGIN_PX, float("nan"), doubt=doubt)
    edges = fit.edges.subset(fit.used)
    residuals, derivatives = edges.rows(camera, pose)
    rms = float(np.sqrt(np.mean(residuals**2)))
    by_pose = float(np.einsum("ni,ij,nj->n", derivatives, given.covariance, derivatives).mean())
    allowed = _OFF_SIGMAS * float(np.sqrt(fit.sigma_px**2 + by_pose))
    off = None
    if rms > max(allowed, _OFF_WIDTH * edges.width_px):
        off = Doubt(
            "given_pose_off_outline",
            f"the given pose of the mirror puts its outline {rms:.2f} px RMS off its edges in the image (its sigmas "
            f"allow {allowed:.2f} px); check [mirror.pose], or leave it out and the outline gives the pose",
            {"residual_rms_px": rms, "allowed_px": allowed},
        )
    margin_px = edge_margin_px(edges.width_px, fit.sigma_px)
    observations = observed(fit, camera, knowledge or Knowledge())
    return OutlineCheck(fit.pose, margin_px, rms, edges.width_px, off, fit.rms_px, observations)


def _refuse_strayed(
    fit: OutlineFit, camera: Camera, facets: Sequence[Facet], pose: RigidTransform, facet_px: float
) -> None:
    """Refuse a fit that left the given pose for edges of something else (a facet beside the image's border, say)."""
    corners = np.concatenate([facet.ensemble_from_facet.apply(facet.corners_m) for facet in facets])
    shift = camera.project(fit.pose.apply(corners)) - camera.project(pose.apply(corners))
    farthest = float(np.max(np.hypot(*shift.T)))
    if not farthest <= _FARTHEST * facet_px:
        raise EstimationError(
            f"the edges found put a corner {farthest:.1f} px from where the given pose has it; check [mirror.pose], "
            "and leave some room between the mirror and the border of the image"
        )
