"""What is known about targets besides their images: distances, coordinates, control points and planes, with sigma."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, covariance_matrix, float_array, positive

AXES = ("x", "y", "z")


class Constraint(Protocol):
    """One or more observations of targets that are no image points; no robust loss weakens them."""

    @property
    def name(self) -> str:
        """What is known, for messages and tables."""
        ...

    @property
    def targets(self) -> tuple[str, ...]:
        """Targets it is about."""
        ...

    def rows(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals (state minus known, over sigma), shape (r,), and derivatives, shape (r, k, 3)."""
        ...


@dataclass(frozen=True, slots=True)
class Distance:
    """A known distance between two targets: a scale bar, a taped length.

    sigma_m: Its standard deviation [m].
    InputError: A number is not positive or the targets are the same.

    Residual ``|P_a - P_b| - d`` (Owkes 2012, eq. 5.36, whose printed right side subtracts lengths from their
    squares).
    """

    target_a: str
    target_b: str
    distance_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        positive(f"{self.name}: distance_m", self.distance_m, "metres")
        positive(f"{self.name}: sigma_m", self.sigma_m, "metres")
        if self.target_a == self.target_b:
            raise InputError(f"{self.name}: two different targets are needed")

    @property
    def name(self) -> str:
        """What is known."""
        return f"distance {self.target_a} - {self.target_b}"

    @property
    def targets(self) -> tuple[str, ...]:
        """The two targets."""
        return (self.target_a, self.target_b)

    def rows(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals and derivatives."""
        difference = points_m[0] - points_m[1]
        length = float(np.linalg.norm(difference))
        direction = difference / max(length, 1e-300)
        jacobian = np.stack([direction, -direction])[None] / self.sigma_m
        return np.array([(length - self.distance_m) / self.sigma_m]), jacobian


@dataclass(frozen=True, slots=True)
class Coordinate:
    """A known coordinate of one target, ``X - X_p = 0`` (Owkes 2012, eq. 5.35, whose printed sign is wrong).

    axis: "x", "y" or "z" of the world frame.
    value_m, sigma_m: The coordinate and its standard deviation [m].
    InputError: No such axis, or a sigma that is not positive.
    """

    target: str
    axis: str
    value_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise InputError(f"coordinate of {self.target}: axis x, y or z is needed, not {self.axis!r}")
        positive(f"{self.name}: sigma_m", self.sigma_m, "metres")

    @property
    def name(self) -> str:
        """What is known."""
        return f"{self.axis} of {self.target}"

    @property
    def targets(self) -> tuple[str, ...]:
        """The target."""
        return (self.target,)

    def rows(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals and derivatives."""
        index = AXES.index(self.axis)
        jacobian = np.zeros((1, 1, 3))
        jacobian[0, 0, index] = 1 / self.sigma_m
        return (points_m[0, index : index + 1] - self.value_m) / self.sigma_m, jacobian


@dataclass(frozen=True, slots=True, eq=False)
class ControlPoint(ShortRepr):
    """Known coordinates of a target, with their covariance.

    xyz_m (3,): Its coordinates [m].
    covariance_m2 (3, 3): Their covariance [m^2]. For a point without error, list it as ``fixed`` of the problem.
    InputError: The covariance is not positive definite.
    """

    target: str
    xyz_m: FloatArray
    covariance_m2: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz_m", float_array(f"{self.name}: xyz_m", self.xyz_m, (3,)))
        covariance = covariance_matrix(f"{self.name}: covariance_m2", self.covariance_m2, 3)
        object.__setattr__(self, "covariance_m2", covariance)
        if np.linalg.eigvalsh(covariance).min() <= 0:
            raise InputError(f"{self.name}: a sigma of 0 is no weight; list the target as fixed")

    @property
    def name(self) -> str:
        """What is known."""
        return f"control point {self.target}"

    @property
    def targets(self) -> tuple[str, ...]:
        """The target."""
        return (self.target,)

    def rows(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals and derivatives."""
        root = np.linalg.inv(np.linalg.cholesky(self.covariance_m2))
        return root @ (points_m[0] - self.xyz_m), root[:, None, :]


@dataclass(frozen=True, slots=True, eq=False)
class KnownPlaces(ShortRepr):
    """Known coordinates of several targets with their joint covariance: parts mounted by drawing, targets on parts.

    places_m (k, 3): Their coordinates [m].
    covariance_m2 (3 k, 3 k): Covariance of all coordinates, x, y, z of each target in turn [m^2].
    InputError: The covariance is not positive definite, or not of as many coordinates.
    """

    targets: tuple[str, ...]
    places_m: FloatArray
    covariance_m2: FloatArray
    _root: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        count = len(self.targets)
        object.__setattr__(self, "places_m", float_array(f"{self.name}: places_m", self.places_m, (count, 3)))
        covariance = covariance_matrix(f"{self.name}: covariance_m2", self.covariance_m2, 3 * count)
        object.__setattr__(self, "covariance_m2", covariance)
        if np.linalg.eigvalsh(covariance).min() <= 0:
            raise InputError(f"{self.name}: a covariance that is not positive definite is no weight")
        object.__setattr__(self, "_root", np.linalg.inv(np.linalg.cholesky(covariance)))

    @property
    def name(self) -> str:
        """What is known."""
        return f"known places of {len(self.targets)} targets"

    def of(self, names: Collection[str]) -> "KnownPlaces":
        """Return what is known of some of the targets."""
        kept = np.array([name in names for name in self.targets], dtype=np.bool_)
        rows = np.flatnonzero(np.repeat(kept, 3))
        chosen = tuple(name for name in self.targets if name in names)
        return KnownPlaces(chosen, self.places_m[kept], self.covariance_m2[np.ix_(rows, rows)])

    def rows(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals and derivatives."""
        return self._root @ (points_m - self.places_m).ravel(), self._root.reshape(3 * len(self.targets), -1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class KnownPlane(ShortRepr):
    """Targets on a plane that is known, normal times X equal to ``offset_m``.

    normal (3,): Normal of the plane, of any length.
    offset_m: Distance of the plane from the origin along the unit normal [m].
    sigma_m: Standard deviation of each target's distance from the plane [m].
    InputError: No length of the normal, or a sigma that is not positive.
    """

    targets: tuple[str, ...]
    normal: FloatArray
    offset_m: float
    sigma_m: float

    def __post_init__(self) -> None:
        normal = float_array("plane: normal", self.normal, (3,))
        positive("plane: length of the normal", float(np.linalg.norm(normal)), "any unit")
        positive("plane: sigma_m", self.sigma_m, "metres")
        object.__setattr__(self, "normal", normal / np.linalg.norm(normal))

    @property
    def name(self) -> str:
        """What is known."""
        return f"known plane of {len(self.targets)} targets"

    def rows(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals and derivatives."""
        jacobian = np.eye(len(self.targets))[:, :, None] * (self.normal / self.sigma_m)
        return (points_m @ self.normal - self.offset_m) / self.sigma_m, jacobian


@dataclass(frozen=True, slots=True)
class CommonPlane(ShortRepr):
    """Targets on one plane that is not known otherwise.

    targets: At least four targets, not on one line.
    sigma_m: Standard deviation of each target's distance from the plane [m].
    InputError: Fewer than four targets or a sigma that is not positive.

    The plane's three parameters are eliminated: the residuals are the distances from the best-fit plane, projected on
    an orthonormal basis of what no plane can take up, so k targets count as k - 3 observations.
    """

    targets: tuple[str, ...]
    sigma_m: float

    def __post_init__(self) -> None:
        positive("common plane: sigma_m", self.sigma_m, "metres")
        if len(set(self.targets)) < 4:
            raise InputError(f"common plane: at least 4 different targets are needed, not {len(set(self.targets))}")

    @property
    def name(self) -> str:
        """What is known."""
        return f"common plane of {len(self.targets)} targets"

    def rows(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return whitened residuals and derivatives."""
        centered = points_m - points_m.mean(axis=0)
        _, _, axes = np.linalg.svd(centered, full_matrices=False)
        in_plane = np.column_stack([np.ones(len(centered)), centered @ axes[:2].T])
        complement = np.linalg.qr(in_plane, mode="complete")[0][:, 3:].T / self.sigma_m
        return complement @ (centered @ axes[2]), complement[:, :, None] * axes[2]


def constrained_targets(constraints: Sequence[Constraint]) -> tuple[str, ...]:
    """Return the names of all targets that constraints mention, in order, each once."""
    return tuple(dict.fromkeys(target for one in constraints for target in one.targets))
