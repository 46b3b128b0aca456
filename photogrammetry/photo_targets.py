"""All circular targets of one photo: found, read, centred."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from heliogauge.errors import EstimationError
from photogrammetry.coded_targets import RingDictionary
from photogrammetry.decode import RingLimits, RingReading, read_ring, ring_outline
from photogrammetry.detect import Candidate, SearchLimits, find_candidates, measure_center
from photogrammetry.detections import Detections
from photogrammetry.target_center import CenterOperator, TargetCenter
from photogrammetry.template_center import template_center

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
    candidates = find_candidates(image_dn, search.limits)
    coded: list[tuple[TargetCenter, RingReading]] = []
    rest: list[Candidate] = []
    for candidate in candidates:
        reading = _reading(image_dn, candidate, search)
        if reading is None:
            rest.append(candidate)
            continue
        try:
            coded.append((measure_center(image_dn, candidate.ellipse, search.operator), reading))
        except EstimationError:
            rest.append(candidate)
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


def _reading(image_dn: npt.NDArray[np.generic], candidate: Candidate, search: TargetSearch) -> RingReading | None:
    if search.dictionary is None:
        return None
    return read_ring(image_dn, candidate.ellipse, search.dictionary, search.ring_limits)


def _uncoded(
    image_dn: npt.NDArray[np.generic],
    candidates: Sequence[Candidate],
    coded: Sequence[TargetCenter],
    search: TargetSearch,
) -> list[TargetCenter]:
    """Measure the dots without a code that do not lie within a coded target."""
    rings = [ring_outline(center.ellipse) for center in coded]
    middles = np.array([ring.center_px for ring in rings]).reshape(-1, 2)
    conics = np.array([np.linalg.inv(ring.shape_px2) for ring in rings]).reshape(-1, 2, 2)
    kept = []
    for candidate in candidates:
        off = candidate.ellipse.center_px - middles
        if (np.einsum("ni,nij,nj->n", off, conics, off) < 1).any():
            continue
        try:
            center = measure_center(image_dn, candidate.ellipse, search.operator)
        except EstimationError:
            continue
        if center.misfit < search.most_misfit:
            kept.append(center)
    return kept


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
