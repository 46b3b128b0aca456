"""What a bundle adjustment does not determine, by name, with the remedy."""

from dataclasses import dataclass

import numpy as np

from heliogauge.validate import FloatArray
from photogrammetry.bundle.covariance import BundleCovariance
from photogrammetry.bundle.problem import BundleProblem
from photogrammetry.bundle.system import SchurSystem

# Entries of a unit direction below this are not worth a name.
_NAMED = 0.05
_MOST_NAMES = 8


@dataclass(frozen=True, slots=True)
class Defect:
    """Degrees of freedom that nothing holds.

    targets, photos, intrinsics: Whom they concern, those most concerned first.
    text: The same in one sentence, with the remedy.
    """

    count: int
    targets: tuple[str, ...]
    photos: tuple[str, ...]
    intrinsics: tuple[str, ...]
    text: str


def diagnose(problem: BundleProblem, system: SchurSystem, covariance: BundleCovariance) -> tuple[Defect, ...]:
    """Name everything that an adjustment does not determine.

    Returns: First targets that fail on their own (one ray, no angle between the rays), then what photos and
        intrinsics share; empty when all is determined.
    """
    found = (_find_lonely_targets(problem, system), _find_shared_defect(problem, system, covariance))
    return tuple(one for one in found if one is not None)


def _find_lonely_targets(problem: BundleProblem, system: SchurSystem) -> Defect | None:
    lost = system.undamped.lost_targets
    which = np.nonzero(lost > 0)[0]
    if not which.size:
        return None
    table, places = problem.observations, system.layout.eliminated[which]
    rays = table.n_rays[places]
    names = tuple(table.targets[i] for i in places)
    described = [f"{name} ({count} ray{'' if count == 1 else 's'})" for name, count in zip(names, rays, strict=True)]
    count = int(lost.sum())
    text = (
        f"{count} degrees of freedom of {len(names)} targets are not determined: {_list_names(tuple(described))}; each "
        "needs two rays that meet at an angle, or known coordinates, or leave it out"
    )
    return Defect(count, names, (), (), text)


def _find_shared_defect(problem: BundleProblem, system: SchurSystem, covariance: BundleCovariance) -> Defect | None:
    dense, inner = covariance.lost_movements
    count = dense.shape[1]
    if not count:
        return None
    layout, table = system.layout, problem.observations
    dense, moved_targets = _localise(system, dense, inner * system.target_scale[:, :, None])
    of_photo = _share(dense[: 6 * layout.n_photos].reshape(layout.n_photos, 6 * count))
    photos = _name_strongest(of_photo, table.photos)
    intrinsics: list[str] = []
    for model, columns in zip(problem.cameras, layout.intrinsic_columns, strict=True):
        intrinsics += _name_strongest(_share(dense[columns]), tuple(f"{name} of {model.name}" for name in model.free))
    moved = _share(moved_targets.reshape(layout.eliminated.size, 3 * count))
    names = tuple(table.targets[i] for i in layout.eliminated)
    targets = _name_strongest(moved, names)
    parts = []
    if photos:
        seen = table.n_targets_in_photo
        place = {name: i for i, name in enumerate(table.photos)}
        parts.append("photos " + _list_names(tuple(f"{name} ({seen[place[name]]} targets)" for name in photos)))
    if targets:
        parts.append("targets " + _list_names(targets))
    if intrinsics:
        parts.append("intrinsics " + _list_names(tuple(intrinsics)))
    text = (
        f"{count} degrees of freedom are not determined; they move {', '.join(parts)}. "
        "Add image points that tie these to the rest, hold an intrinsic or give it a prior, or leave the photos out"
    )
    return Defect(count, targets, photos, tuple(intrinsics), text)


def _localise(system: SchurSystem, dense: FloatArray, targets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Take the movement of the whole network out of lost directions, so that few photos and targets move.

    A loose photo against a network at rest, and the network against the photo at rest, are the same freedom. The
    version in which least moves (sum of lengths, by iterated weights) names the photo.
    """
    layout = system.layout
    count = system.movements.count
    if not count:
        return dense, targets
    own = system.dense_movements * system.dense_scale[:, None]
    inner = system.movements.points[layout.eliminated] * system.target_scale[:, :, None]
    columns = np.concatenate([own, inner.reshape(3 * layout.eliminated.size, count)])
    lost = np.concatenate([dense, targets.reshape(3 * layout.eliminated.size, dense.shape[1])])
    loose = layout.n_global - 6 * layout.n_photos
    blocks = np.concatenate(
        [
            np.repeat(np.arange(layout.n_photos), 6),
            layout.n_photos + np.arange(loose),
            layout.n_photos + loose + np.repeat(np.arange(layout.eliminated.size), 3),
        ]
    )
    result_columns = []
    for direction in lost.T:
        weight, rest = np.ones(direction.size), direction
        for _ in range(30):
            amounts = np.linalg.lstsq(columns * weight[:, None], -direction * weight, rcond=None)[0]
            rest = direction + columns @ amounts
            lengths = np.sqrt(np.bincount(blocks, weights=rest**2))
            weight = 1 / np.sqrt(lengths + 1e-6 * lengths.max() + 1e-300)[blocks]
        result_columns.append(rest / max(float(np.linalg.norm(rest)), 1e-300))
    final = np.stack(result_columns, axis=1)
    size = layout.n_global
    return final[:size], final[size:].reshape(layout.eliminated.size, 3, dense.shape[1])


def _share(rows: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt((rows**2).sum(axis=1)))


def _name_strongest(share: FloatArray, names: tuple[str, ...]) -> tuple[str, ...]:
    order = np.argsort(-share, kind="stable")
    return tuple(names[i] for i in order if share[i] > _NAMED)


def _list_names(names: tuple[str, ...]) -> str:
    rest = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {rest} more" if rest > 0 else "")
