"""Where the mirror is: from the pose as given, from its outline, or from its reflection alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from deflectometry.pose.adjust_pose import MirrorPose, pose_from_outline, pose_from_points
from deflectometry.pose.facet_places import FacetPlace, FacetPlaces, OutlinedEnsemble, facet_places, stated_places
from deflectometry.pose.given_pose import check_given_pose
from deflectometry.pose.pose_observations import Knowledge, UncertainPose
from deflectometry.pose.pose_without_outline import outline_from_image
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.sources.source import Source
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet, Quadric
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import Float32Array, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class MirrorInput(ShortRepr):
    """What is known of the mirror before it is measured.

    facets: Facets with outline and design; empty where the outline is not known.
    design: Design of a mirror without outline, in the frame whose origin is the middle of what is seen.
    known_pose: The pose, where it was measured otherwise.
    knowledge: Distances, known points and roll that help to find the pose.
    """

    name: str
    facets: tuple[Facet, ...]
    design: Quadric
    known_pose: UncertainPose | None
    knowledge: Knowledge


@dataclass(frozen=True, slots=True, eq=False)
class LocatedMirror:
    """Where the mirror is.

    facets: Facets; of a mirror without outline the one made from its image.
    pose: Pose before alignment.
    margin_px: Distance to the outline below which pixels mix the mirror with its surroundings [px].
    source: Where the pose comes from, in words with numbers.
    outline_pose: Pose whose outline lies on the edges in the image: defines which pixels see the mirror. Differs from
        `pose` only where that was given.
    evidence: The adjustment, where the outline gave the pose.
    doubts: What makes the pose doubtful.
    edge_width_px: Width of the mirror's edges in the image; NaN where none were measured [px].
    sigma_outline_px: How far the outline of `outline_pose` may be off the edges: as the edge points scatter about it;
        0 where none were measured [px].
    places: How well the place of each facet of an ensemble is known; empty for a single facet.
    """

    facets: tuple[Facet, ...]
    pose: UncertainPose
    margin_px: float
    source: str
    outline_pose: RigidTransform
    evidence: MirrorPose | None = None
    doubts: tuple[Doubt, ...] = ()
    edge_width_px: float = float("nan")
    sigma_outline_px: float = 0.0
    places: tuple[FacetPlace, ...] = ()


def find_pose(source: Source, setup: Setup, mirror: MirrorInput) -> LocatedMirror:
    """Find where the mirror is: from the pose as given, from its outline, or from its reflection alone.

    source: Images that show the mirror.
    setup: Camera and screen.
    EstimationError: No mirror in view, or an outline that does not fit.
    """
    image = source.mirror_image()
    if mirror.facets and mirror.known_pose is not None:
        checked = check_given_pose(
            image, setup.camera, mirror.facets, mirror.known_pose, source.clutter(), mirror.knowledge
        )
        places = FacetPlaces()
        if checked.observations is not None:
            # A given pose does not follow the outlines, which tell of the facets' places among themselves.
            fitted = checked.observations.adjust(setup.camera, checked.outline_pose).require("pose of the outlines")
            outlined = OutlinedEnsemble(
                setup.camera, mirror.facets, checked.observations, fitted.state, fitted.covariance, gives_pose=False
            )
            places = _places(outlined, mirror)
        elif len(mirror.facets) > 1:
            places = stated_places(mirror.facets, _stated(mirror))
        words = f"given in measurement.toml; its outline lies {checked.residual_rms_px:.3f} px RMS off the edges"
        return LocatedMirror(
            mirror.facets,
            mirror.known_pose,
            checked.margin_px,
            words,
            checked.outline_pose,
            doubts=gather_doubts(checked.doubt, places.doubts),
            edge_width_px=checked.edge_width_px,
            sigma_outline_px=checked.scatter_px,
            places=places.places,
        )
    if not mirror.facets:
        return _find_without_outline(source, image, setup, mirror)
    evidence = pose_from_outline(image, setup.camera, mirror.facets, mirror.knowledge, clutter=source.clutter())
    outlined = OutlinedEnsemble(
        setup.camera,
        mirror.facets,
        evidence.observations,
        evidence.cam_from_mirror,
        evidence.covariance,
        gives_pose=True,
    )
    places = _places(outlined, mirror)
    words = (
        f"outline in the image: {evidence.n_points} edge points, residual {evidence.residual_rms_px:.3f} px RMS, "
        f"{evidence.n_rejected} rejected"
    )
    return LocatedMirror(
        mirror.facets,
        evidence.uncertain_pose,
        evidence.mask_margin_px,
        words,
        evidence.cam_from_mirror,
        evidence,
        gather_doubts(evidence.doubts, places.doubts),
        evidence.edge_width_px,
        float(np.nan_to_num(evidence.residual_rms_px)),
        places.places,
    )


def _stated(mirror: MirrorInput) -> Sequence[FloatArray | None]:
    return mirror.knowledge.sigma_places_m or (None,) * len(mirror.facets)


def _places(outlined: OutlinedEnsemble, mirror: MirrorInput) -> FacetPlaces:
    return facet_places(outlined, _stated(mirror))


def _find_without_outline(source: Source, image: Float32Array, setup: Setup, mirror: MirrorInput) -> LocatedMirror:
    """Make a facet from what is seen: the outline from the image, the pose from the reflection and the distance."""
    rough = outline_from_image(image)
    screen_map = source.screen_map(rough.region)
    evidence = None
    if mirror.known_pose is not None:
        pose, words = mirror.known_pose, "given in measurement.toml (no outline given)"
    elif len(mirror.knowledge.points.points_m):
        evidence = pose_from_points(setup.camera, mirror.knowledge)
        pose = evidence.uncertain_pose
        words = f"{evidence.n_points} known points, residual {evidence.residual_rms_px:.3f} px RMS (no outline given)"
    else:
        reflect = partial(rough.pose, screen_map, mirror.knowledge, mirror.design)
        pose = UncertainPose(*reflect(setup), lambda other: reflect(other)[0])
        words = "reflection at the middle of the mirror and the measured distance (no outline given)"
    facet = rough.facet(mirror.name, mirror.design, setup.camera, pose.cam_from_mirror)
    doubts = () if evidence is None else evidence.doubts
    width_px = rough.edge_width_px
    return LocatedMirror((facet,), pose, rough.margin_px, words, pose.cam_from_mirror, evidence, doubts, width_px)
