"""All circular targets of one photo: found, read, centred."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from photogrammetry.coded_targets import VENDOR_RADII, RingDictionary
from photogrammetry.decode import RingLimits, RingReading, read_rings, ring_outline
from photogrammetry.detect import Candidate, SearchLimits, find_in_pyramid, measure_center
from photogrammetry.detections import Detections
from photogrammetry.ellipse import Ellipse
from photogrammetry.pyramid import make_pyramid
from photogrammetry.target_center import REACH, CenterOperator, TargetCenter
from photogrammetry.template_center import template_center, template_centers

__all__ = ["PhotoTargets", "TargetSearch", "measure_targets"]


@dataclass(frozen=True, slots=True, eq=False)
class TargetSearch:
    """What is searched for in photos, and how it is measured.

    Parameters
    ----------
    dictionary : RingDictionary or None, optional
        The ring codes that may occur; None for targets without code only.
    limits : SearchLimits, optional
        Sizes, contrast, tilt, polarity.
    ring_limits : RingLimits, optional
        How good a code ring must be.
    with_uncoded : bool, optional
        Also return dots without a code ring.
    operator : CenterOperator, optional
        Estimator of the centres.
    most_misfit : float, optional
        Residual of a dot without code as a share of its contrast, above which it is none.
    """

    dictionary: RingDictionary | None = None
    limits: SearchLimits = field(default_factory=SearchLimits)
    ring_limits: RingLimits = field(default_factory=RingLimits)
    with_uncoded: bool = True
    operator: CenterOperator = template_center
    most_misfit: float = 0.08


@dataclass(frozen=True, slots=True, eq=False)
class PhotoTargets:
    """The targets of one photo and what was noticed about them.

    Parameters
    ----------
    detections : Detections
        Coded targets by their names, then dots without a code as "u0", "u1"...
    centers : tuple of TargetCenter
        All that is known of each detection.
    readings : tuple of RingReading
        The readings of the coded targets, first in the detections.
    mirrored : tuple of str
        Names of codes that are in the dictionary only as mirror images (print or photo is mirrored); not detections.
    unknown_words : tuple of str
        Sectors ("110100...") of good rings whose word is not in the dictionary.
    duplicated : tuple of str
        Names that occur more than once; all of them are among the detections.
    """

    detections: Detections
    centers: tuple[TargetCenter, ...]
    readings: tuple[RingReading, ...]
    mirrored: tuple[str, ...]
    unknown_words: tuple[str, ...]
    duplicated: tuple[str, ...]


def measure_targets(image_dn: npt.NDArray[np.generic], photo: str, search: TargetSearch) -> PhotoTargets:
    """Find, read and centre all circular targets of a photo.

    Parameters
    ----------
    image_dn : ndarray, shape (h, w)
        Grey values: uint8, uint16 or float32 [DN].
    photo : str
        Name of the photo.
    search : TargetSearch
        What is searched for.

    Returns
    -------
    PhotoTargets
        Detections with covariances, and what was noticed. No target is no error.
    """
    pyramid = make_pyramid(image_dn)
    dictionary = search.dictionary
    limits = search.limits if dictionary is None else replace(search.limits, gap_radius=dictionary.radii.inner)
    candidates = find_in_pyramid(pyramid, limits)
    dots = [candidate.ellipse for candidate in candidates]
    readings = [None] * len(dots) if dictionary is None else read_rings(pyramid, dots, dictionary, search.ring_limits)
    ringed = [k for k, reading in enumerate(readings) if reading is not None]
    coded: list[tuple[TargetCenter, RingReading]] = []
    rest = [candidates[k] for k, reading in enumerate(readings) if reading is None]
    for k, center in zip(ringed, _centers(image_dn, [dots[k] for k in ringed], search), strict=True):
        reading = readings[k]
        if isinstance(center, TargetCenter) and reading is not None:
            coded.append((center, reading))
        else:
            rest.append(candidates[k])
    named = [(center, reading) for center, reading in coded if reading.code is not None]
    uncoded = _uncoded(image_dn, rest, [center for center, _ in coded], search) if search.with_uncoded else []
    names = [reading.code.name for _, reading in named if reading.code is not None]
    centers = [center for center, _ in named] + uncoded
    detections = _detections(photo, names + [f"u{k}" for k in range(len(uncoded))], centers)
    others = [reading for _, reading in coded if reading.code is None]
    return PhotoTargets(
        detections,
        tuple(centers),
        tuple(reading for _, reading in named),
        tuple(reading.mirrored.name for reading in others if reading.mirrored is not None),
        tuple("".join("01"[bit] for bit in reading.sectors) for reading in others if reading.mirrored is None),
        detections.duplicated,
    )


def _centers(
    image_dn: npt.NDArray[np.generic], dots: Sequence[Ellipse], search: TargetSearch
) -> Sequence[TargetCenter | EstimationError]:
    """Measure centres: the template's all at once, those of other operators one by one."""
    if search.operator is template_center:
        gap = 1.0 if search.dictionary is None else search.dictionary.radii.inner - 1
        return template_centers(image_dn, dots, min(REACH, 1 + (REACH - 1) * gap))
    found: list[TargetCenter | EstimationError] = []
    for dot in dots:
        try:
            found.append(measure_center(image_dn, dot, search.operator))
        except EstimationError as error:
            found.append(error)
    return found


def _uncoded(
    image_dn: npt.NDArray[np.generic],
    candidates: Sequence[Candidate],
    coded: Sequence[TargetCenter],
    search: TargetSearch,
) -> list[TargetCenter]:
    """Measure the dots without a code that do not lie within a coded target."""
    radii = VENDOR_RADII if search.dictionary is None else search.dictionary.radii
    rings = [ring_outline(center.ellipse, radii) for center in coded]
    middles = np.array([ring.center_px for ring in rings]).reshape(-1, 2)
    conics = np.array([np.linalg.inv(ring.shape_px2) for ring in rings]).reshape(-1, 2, 2)
    off = np.array([candidate.ellipse.center_px for candidate in candidates]).reshape(-1, 1, 2) - middles
    within = (np.einsum("mni,nij,mnj->mn", off, conics, off) < 1).any(axis=1)
    free = [candidate.ellipse for candidate, covered in zip(candidates, within, strict=True) if not covered]
    centers = [center for center in _centers(image_dn, free, search) if isinstance(center, TargetCenter)]
    return [center for center in centers if center.misfit < search.most_misfit]


def _detections(photo: str, names: Sequence[str], centers: Sequence[TargetCenter]) -> Detections:
    n = len(centers)
    return Detections(
        photo,
        tuple(names),
        np.array([center.center_px for center in centers]).reshape(n, 2),
        np.array([center.covariance_px2 for center in centers]).reshape(n, 2, 2),
        np.array([center.ellipse.radius_px for center in centers]).reshape(n),
        np.zeros(n, dtype=np.uint32),
    )
