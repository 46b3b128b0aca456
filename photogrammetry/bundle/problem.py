"""The question of a bundle adjustment: image points, cameras and what of them is free, constraints, datum."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from heliogauge.adjust.least_squares import Prior
from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray, covariance_matrix, float_array
from photogrammetry.bundle.constraints import Constraint, constrained_targets
from photogrammetry.bundle.datum import Datum
from photogrammetry.bundle.state import INTRINSIC_NAMES, BundleState
from photogrammetry.image_points import ImagePoints


class ResidualSpace(StrEnum):
    """Where image residuals are formed."""

    MEASURED = "measured image"
    CORRECTED = "image corrected for distortion"


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel(ShortRepr):
    """What is estimated of one physical camera; the rest is held at the values of the start.

    free: Names from `INTRINSIC_NAMES` that are estimated.
    priors: Values of free intrinsics known before, each with its sigma.
    prior_covariance (10, 10): Joint covariance of `INTRINSIC_NAMES` from an earlier calibration.
    prior_values (10,): What that calibration found; the values of the start by default, which only then are right
        when nothing has been adjusted before.
    residual: Where residuals are formed; the covariance of the image points is taken in that image. DBAT's backward
        (photogrammetric) models use CORRECTED: an image without lens and with square pixels of the rows' focal
        length.
    InputError: An unknown or repeated name, or a prior of an intrinsic that is held.
    """

    name: str
    free: tuple[str, ...] = ()
    priors: tuple[Prior, ...] = ()
    prior_covariance: FloatArray | None = None
    prior_values: FloatArray | None = None
    residual: ResidualSpace = ResidualSpace.MEASURED

    def __post_init__(self) -> None:
        unknown = [name for name in self.free if name not in INTRINSIC_NAMES]
        if unknown or len(set(self.free)) != len(self.free):
            raise InputError(
                f"camera {self.name}: free intrinsics must be different ones of {', '.join(INTRINSIC_NAMES)}, "
                f"not {', '.join(self.free)}"
            )
        # One order everywhere, whatever the caller's was.
        object.__setattr__(self, "free", tuple(name for name in INTRINSIC_NAMES if name in self.free))
        held = [prior.name for prior in self.priors if prior.name not in self.free]
        if held:
            raise InputError(f"camera {self.name}: {', '.join(held)} has a prior but is not free")
        if self.prior_covariance is not None:
            covariance = covariance_matrix(f"camera {self.name}: prior_covariance", self.prior_covariance, 10)
            object.__setattr__(self, "prior_covariance", covariance)
        if self.prior_values is not None:
            values = float_array(f"camera {self.name}: prior_values", self.prior_values, (10,))
            object.__setattr__(self, "prior_values", values)

    @property
    def columns(self) -> IntArray:
        """Places of the free intrinsics in `INTRINSIC_NAMES`."""
        return np.array([INTRINSIC_NAMES.index(name) for name in self.free], dtype=np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class BundleProblem(ShortRepr):
    """What is observed and what is sought.

    observations: The image points.
    cameras: The physical cameras.
    camera_of_photo (p,): Camera of each photo; the first one by default.
    constraints: Scale bars, distances, coordinates, control points with sigma, planes.
    fixed: Targets whose coordinates are those of the start, without error.
    datum: How position, rotation and scale are defined as far as constraints and fixed targets leave them open.
    InputError: An unknown target or camera, or a photo without camera.
    """

    observations: ImagePoints
    cameras: tuple[CameraModel, ...]
    camera_of_photo: IntArray | None = None
    constraints: tuple[Constraint, ...] = ()
    fixed: tuple[str, ...] = ()
    datum: Datum = field(default_factory=Datum)

    def __post_init__(self) -> None:
        count = len(self.observations.photos)
        index = np.zeros(count, np.intp) if self.camera_of_photo is None else np.array(self.camera_of_photo, np.intp)
        if index.shape != (count,) or (index < 0).any() or (index >= len(self.cameras)).any():
            raise InputError(f"camera_of_photo: {count} indices below {len(self.cameras)} are needed")
        object.__setattr__(self, "camera_of_photo", index)
        known = set(self.observations.targets)
        lost = [name for name in self.datum.photos if name not in self.observations.photos]
        if lost:
            raise InputError(f"photos {', '.join(lost)}: named by the datum, but not in the network")
        asked = [*constrained_targets(self.constraints), *self.fixed, *self.datum.targets]
        unknown = sorted({name for name in asked if name not in known})
        if unknown:
            raise InputError(
                f"targets {', '.join(unknown)}: named by a constraint, as fixed or by the datum, but not measured"
            )

    @property
    def camera_index(self) -> IntArray:
        """Camera of each photo, shape (p,)."""
        return np.zeros(0, np.intp) if self.camera_of_photo is None else self.camera_of_photo

    def target_indices(self, names: Sequence[str]) -> IntArray:
        """Return the places of targets."""
        if not names:
            return np.zeros(0, dtype=np.intp)
        place = {name: i for i, name in enumerate(self.observations.targets)}
        return np.array([place[name] for name in names], dtype=np.intp)

    @property
    def constraint_targets(self) -> tuple[IntArray, ...]:
        """Places of the targets of each constraint."""
        every = self.target_indices([name for one in self.constraints for name in one.targets])
        return tuple(np.split(every, np.cumsum([len(one.targets) for one in self.constraints], dtype=np.intp))[:-1])


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Where each unknown is in the vector of unknowns: photos, intrinsics, kept targets, then eliminated targets.

    Targets that an observation other than an image point links to another target are kept in the dense part; all
    others are eliminated one by one (Schur complement).

    intrinsic_columns: Columns of each camera's free intrinsics.
    kept, eliminated: Targets of the dense part, and those outside it.
    kept_column (n,): First column of each target of the dense part, -1 for others.
    slot (n,): Place of each target among the eliminated, -1 for others (kept or fixed).
    """

    n_photos: int
    intrinsic_columns: tuple[IntArray, ...]
    kept: IntArray
    eliminated: IntArray
    kept_column: IntArray
    slot: IntArray

    @property
    def n_global(self) -> int:
        """Number of unknowns in the dense part."""
        return 6 * self.n_photos + sum(len(columns) for columns in self.intrinsic_columns) + 3 * self.kept.size

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.n_global + 3 * int(self.eliminated.size)


def layout_of(problem: BundleProblem, state: BundleState) -> Layout:
    """Order the unknowns of a problem.

    state: The start, to see which targets each constraint links.
    """
    n_targets = len(problem.observations.targets)
    fixed = problem.target_indices(problem.fixed)
    linked: set[int] = set()
    for constraint, index in zip(problem.constraints, problem.constraint_targets, strict=True):
        _, jacobian = constraint.rows(state.points_m[index])
        touches = (jacobian != 0).any(axis=2)
        linked.update(index[touches[touches.sum(axis=1) > 1].any(axis=0)].tolist())
    kept = np.array(sorted(linked - set(fixed.tolist())), dtype=np.intp)
    first = 6 * len(problem.observations.photos)
    columns = []
    for model in problem.cameras:
        columns.append(np.arange(first, first + len(model.free), dtype=np.intp))
        first += len(model.free)
    kept_column = np.full(n_targets, -1, dtype=np.intp)
    kept_column[kept] = first + 3 * np.arange(kept.size)
    is_eliminated = np.ones(n_targets, dtype=np.bool_)
    is_eliminated[kept] = is_eliminated[fixed] = False
    eliminated = np.flatnonzero(is_eliminated)
    slot = np.full(n_targets, -1, dtype=np.intp)
    slot[eliminated] = np.arange(eliminated.size)
    return Layout(len(problem.observations.photos), tuple(columns), kept, eliminated, kept_column, slot)
