"""Where the drives of a heliostat stood, and what all kinds of its observations share."""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.kinematic_model.parameters import Parameters
from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray, TimeArray, float_array, freeze


@dataclass(frozen=True, slots=True, eq=False)
class Pointings(ShortRepr):
    """Where the drives stood, row by row.

    readings (n, 2): Readings of both drives in the design's unit.
    row (n,): Identity of each row (line of the table it came from); 0, 1, ... if not given.
    time (n,): UTC; NaT where unknown.
    approach (n, 2): Direction of each drive's last move: +1, -1, 0 unknown.
    InputError: Lengths differ, or a reading is not finite.
    """

    readings: FloatArray
    row: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    time: TimeArray = field(default_factory=lambda: np.zeros(0, dtype="datetime64[ms]"))
    approach: FloatArray | None = None

    def __post_init__(self) -> None:
        readings = float_array("readings", self.readings, (None, 2))
        count = len(readings)
        row = np.array(self.row, dtype=np.int64) if np.size(self.row) else np.arange(count)
        unknown = np.full(count, np.datetime64("NaT", "ms"))
        time = np.array(self.time, dtype="datetime64[ms]") if np.size(self.time) else unknown
        if row.shape != (count,) or time.shape != (count,):
            raise InputError(f"pointings: {count} readings need as many rows and times, not {row.shape}, {time.shape}")
        object.__setattr__(self, "readings", readings)
        object.__setattr__(self, "row", freeze(row))
        object.__setattr__(self, "time", freeze(time))
        if self.approach is not None:
            object.__setattr__(self, "approach", float_array("approach", self.approach, (count, 2)))

    def __len__(self) -> int:
        return len(self.readings)

    def select(self, mask: BoolArray) -> "Pointings":
        """Return the rows of a mask, shape (n,)."""
        approach = None if self.approach is None else self.approach[mask]
        return Pointings(self.readings[mask], self.row[mask], self.time[mask], approach)


@dataclass(frozen=True, slots=True, eq=False)
class Place(ShortRepr):
    """A camera or a point of a target in the field, known with some sigma or unknown.

    center_m (3,): Where it is, or a rough place [m].
    sigma_m () or (3,): Standard deviation east, north, up [m]: 0 for known, inf for unknown.
    InputError: Another shape, or a sigma that is negative or NaN.
    """

    name: str
    center_m: FloatArray
    sigma_m: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "center_m", float_array(f"center of {self.name}", self.center_m, (3,)))
        object.__setattr__(self, "sigma_m", prior_sigmas(f"sigma_m of {self.name}", self.sigma_m, 3))

    def parameters(self, prefix: str) -> Parameters:
        """Return the three coordinates as parameters named after ``prefix`` and the place."""
        names = tuple(f"{prefix}_{self.name}_{axis}" for axis in "enu")
        return Parameters(names, self.center_m, self.sigma_m, ("m",) * 3)


@dataclass(frozen=True, slots=True, eq=False)
class MountedCamera:
    """A camera that is rigid on the moving structure, in the mirror's frame.

    point_m (3,): Its projection centre in the mirror's frame [m].
    sigma_m () or (3,): Standard deviation of that point [m]: 0 for known, inf for unknown.
    mirror_from_camera (3, 3): Rotation from the camera's frame (z forward) to the mirror's, as planned.
    sigma_rad () or (3,): Standard deviation of that rotation about the mirror's axes [rad]; used by a calibrated
        camera only.
    InputError: Shapes that do not fit, or a sigma that is negative or NaN.
    """

    point_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    sigma_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    mirror_from_camera: FloatArray = field(default_factory=lambda: np.eye(3))
    sigma_rad: FloatArray = field(default_factory=lambda: np.full(3, np.inf))

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_m", float_array("mounted camera: point_m", self.point_m, (3,)))
        object.__setattr__(self, "sigma_m", prior_sigmas("mounted camera: sigma_m", self.sigma_m, 3))
        rotation = float_array("mirror_from_camera", self.mirror_from_camera, (3, 3))
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
            raise InputError("mirror_from_camera: a rotation matrix is needed")
        object.__setattr__(self, "mirror_from_camera", rotation)
        object.__setattr__(self, "sigma_rad", prior_sigmas("mounted camera: sigma_rad", self.sigma_rad, 3))

    @property
    def axis(self) -> FloatArray:
        """Viewing direction in the mirror's frame, shape (3,)."""
        return np.asarray(self.mirror_from_camera[:, 2])


class ObservationGroup(ShortRepr):
    """What all kinds of observations share: rows, and the choice of some of them."""

    __slots__ = ()
    kind: ClassVar[str]
    n_components: ClassVar[int] = 2
    pointings: Pointings

    def __len__(self) -> int:
        return len(self.pointings)

    @property
    def label(self) -> tuple[str, ...]:
        """Target, camera or point of each row."""
        return ("",) * len(self)

    @property
    def sun_or_nan(self) -> FloatArray:
        """Direction to the sun of each row, shape (n, 3); NaN for kinds that do without."""
        return np.full((len(self), 3), np.nan)

    def extra_parameters(self, design: HeliostatDesign) -> Parameters:
        """Return what the observations bring with them besides the heliostat's own numbers."""
        del design
        return Parameters((), np.zeros(0), np.zeros(0), ())

    def select(self, mask: BoolArray) -> Self:
        """Return the rows of a mask, shape (n,)."""
        kept = np.flatnonzero(mask)
        changes: dict[str, object] = {"pointings": self.pointings.select(mask)}
        for item in fields(self):  # type: ignore[arg-type]
            value = getattr(self, item.name)
            # One camera that all lamps share is a value, cameras of rows are names.
            if item.name in _PER_ROW and isinstance(value, tuple | np.ndarray):
                changes[item.name] = tuple(value[i] for i in kept) if isinstance(value, tuple) else value[mask]
        return replace(self, **changes)  # type: ignore[type-var]


#: Fields with one entry per row, by name; all other fields are common to the group.
_PER_ROW = (
    frozenset({"sun", "spot_m", "covariance_m2", "target", "camera", "sigma_rad", "source_m", "source_covariance_m2"})
    | {"lamp_m", "lamp", "position", "direction_camera"}
    | {"normal", "point_mirror_m", "point_m", "point"}
)


def joined_parameters(parts: Iterable[Parameters]) -> Parameters:
    """Join parameters; the same name twice must mean the same."""
    joined = Parameters((), np.zeros(0), np.zeros(0), ())
    for part in parts:
        known = [name in joined.names for name in part.names]
        for name, value, sigma, again in zip(part.names, part.values, part.sigmas, known, strict=True):
            if again and (joined.value(name), joined.sigma(name)) != (value, sigma):
                raise InputError(f"{name}: two groups of observations contradict each other")
        new = ~np.array(known, dtype=np.bool_)
        names = tuple(name for name, again in zip(part.names, known, strict=True) if not again)
        units = tuple(unit for unit, again in zip(part.units, known, strict=True) if not again)
        joined = joined.extended(Parameters(names, part.values[new], part.sigmas[new], units))
    return joined


def unit_rows(name: str, vectors: npt.ArrayLike | None, count: int) -> FloatArray:
    """Return unit vectors, shape (count, 3), or refuse another shape and vectors of length zero."""
    array = float_array(name, np.zeros((0, 3)) if vectors is None else vectors, (count, 3))
    length = np.linalg.norm(array, axis=1, keepdims=True)
    if not (length > 0).all():
        raise InputError(f"{name}: a vector of length zero has no direction (row {int(np.argmin(length))})")
    return np.asarray(freeze(array / length))


def covariance_rows(name: str, values: npt.ArrayLike, count: int) -> FloatArray:
    """Return covariances, shape (count, 3, 3), or refuse another shape and negative variances."""
    array = float_array(name, values, (count, 3, 3))
    try:
        # Rounding may leave a variance that is nothing below zero; where all are zero there is nothing to try.
        np.linalg.cholesky(array + (1e-9 * np.abs(array).max(initial=0.0) + 1e-300) * np.eye(3))
    except np.linalg.LinAlgError as error:
        raise InputError(f"{name}: a covariance must not have a negative variance along any direction") from error
    return array


def prior_sigmas(name: str, values: npt.ArrayLike, count: int) -> FloatArray:
    """Return sigmas that may be 0 (known) or inf (unknown), shape (count,), or refuse negative ones."""
    sigmas = np.array(np.broadcast_to(np.asarray(values, dtype=np.float64), (count,)))
    if not (sigmas >= 0).all():
        raise InputError(f"{name}: 0 (known), positive, or inf (unknown) is needed, not {sigmas.tolist()}")
    return np.asarray(freeze(sigmas))


def sigma_rows(name: str, values: npt.ArrayLike, count: int) -> FloatArray:
    """Return positive, finite sigmas, shape (count,), or refuse them."""
    sigmas = np.array(np.broadcast_to(np.asarray(values, dtype=np.float64), (count,)))
    if not (np.isfinite(sigmas) & (sigmas > 0)).all():
        raise InputError(f"{name}: positive numbers are needed")
    return np.asarray(freeze(sigmas))


def check_names(what: str, names: tuple[str, ...], count: int) -> None:
    """Refuse another number of names than rows."""
    if len(names) != count:
        raise InputError(f"{what}: {count} names are needed, not {len(names)}")


def check_places(what: str, names: tuple[str, ...], places: tuple[Place, ...], count: int) -> None:
    """Refuse names that no place has, or that two have."""
    check_names(what, names, count)
    known = [place.name for place in places]
    unknown = sorted(set(names) - set(known))
    if unknown or len(set(known)) != len(known):
        raise InputError(f"{what} {', '.join(unknown)}: each must be given once; there are {', '.join(known)}")
