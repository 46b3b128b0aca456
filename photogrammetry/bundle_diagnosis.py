"""What a bundle adjustment does not determine, by name, with the remedy."""

from dataclasses import dataclass

import numpy as np

from heliogauge.errors import EstimationError
from heliogauge.validate import FloatArray
from photogrammetry.bundle import BundleResult

# Entries of a unit direction below this are not worth a name.
_NAMED = 0.05
_MOST_NAMES = 8


@dataclass(frozen=True, slots=True)
class Defect:
    """Degrees of freedom that nothing holds.

    Parameters
    ----------
    count : int
        How many.
    targets, photos, intrinsics : tuple of str
        Whom they concern, those most concerned first.
    text : str
        The same in one sentence, with the remedy.
    """

    count: int
    targets: tuple[str, ...]
    photos: tuple[str, ...]
    intrinsics: tuple[str, ...]
    text: str


def diagnose(result: BundleResult) -> tuple[Defect, ...]:
    """Name everything that the adjustment does not determine.

    Parameters
    ----------
    result : BundleResult
        An adjusted network.

    Returns
    -------
    tuple of Defect
        First targets that fail on their own (one ray, no angle between the rays), then what photos and intrinsics
        share; empty when all is determined.
    """
    found = []
    own = _lonely_targets(result)
    if own is not None:
        found.append(own)
    shared = _shared(result)
    if shared is not None:
        found.append(shared)
    return tuple(found)


def require(result: BundleResult, what: str = "bundle adjustment") -> BundleResult:
    """Return the result if it is usable, refuse it otherwise.

    Parameters
    ----------
    result : BundleResult
        An adjusted network.
    what : str, optional
        What was adjusted, for the message.

    Returns
    -------
    BundleResult
        The same result.

    Raises
    ------
    EstimationError
        Not converged, or something is not determined; the message names it.
    """
    defects = diagnose(result)
    if defects:
        raise EstimationError(f"{what}: " + "; ".join(one.text for one in defects))
    if not result.converged:
        raise EstimationError(f"{what}: {result.reason}")
    return result


def _lonely_targets(result: BundleResult) -> Defect | None:
    lost = result.system.undamped.lost_targets
    which = np.nonzero(lost > 0)[0]
    if not which.size:
        return None
    table, places = result.problem.observations, result.system.layout.eliminated[which]
    rays = table.n_rays[places]
    names = tuple(table.targets[i] for i in places)
    described = [f"{name} ({count} ray{'' if count == 1 else 's'})" for name, count in zip(names, rays, strict=True)]
    count = int(lost.sum())
    text = (
        f"{count} degrees of freedom of {len(names)} targets are not determined: {_listed(tuple(described))}; each "
        "needs two rays that meet at an angle, or known coordinates, or leave it out"
    )
    return Defect(count, names, (), (), text)


def _shared(result: BundleResult) -> Defect | None:
    dense, inner = result.covariance.lost_movements
    count = dense.shape[1]
    if not count:
        return None
    layout, table = result.system.layout, result.problem.observations
    of_photo = _share(dense[: 6 * layout.n_photos].reshape(layout.n_photos, 6 * count))
    photos = _named(of_photo, table.photos)
    intrinsics: list[str] = []
    for model, columns in zip(result.problem.cameras, layout.intrinsic_columns, strict=True):
        intrinsics += _named(_share(dense[columns]), tuple(f"{name} of {model.name}" for name in model.free))
    moved = _share((inner * result.system.target_scale[:, :, None]).reshape(layout.eliminated.size, 3 * count))
    names = tuple(table.targets[i] for i in layout.eliminated)
    targets = _named(moved, names)
    parts = []
    if photos:
        seen = table.n_targets_in_photo
        place = {name: i for i, name in enumerate(table.photos)}
        parts.append("photos " + _listed(tuple(f"{name} ({seen[place[name]]} targets)" for name in photos)))
    if targets:
        parts.append("targets " + _listed(targets))
    if intrinsics:
        parts.append("intrinsics " + _listed(tuple(intrinsics)))
    text = (
        f"{count} degrees of freedom are not determined; they move {', '.join(parts)}. "
        "Add image points that tie these to the rest, hold an intrinsic or give it a prior, or leave the photos out"
    )
    return Defect(count, targets, photos, tuple(intrinsics), text)


def _share(rows: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((rows**2).sum(axis=1)))


def _named(share: FloatArray, names: tuple[str, ...]) -> tuple[str, ...]:
    order = np.argsort(-share, kind="stable")
    return tuple(names[i] for i in order if share[i] > _NAMED)


def _listed(names: tuple[str, ...]) -> str:
    rest = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {rest} more" if rest > 0 else "")
