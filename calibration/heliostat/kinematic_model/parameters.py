"""Named parameters of a kinematic model: value, prior sigma and unit of each."""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.validate import BoolArray, FloatArray, IntArray, float_array, freeze

#: Sigma of a parameter that keeps its value, and of one that the observations alone decide.
HELD, FREE = 0.0, float("inf")


class Quantity(NamedTuple):
    """A number with its unit."""

    value: float
    unit: str


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """Values of a model with the names they are known by, and what is known of each beforehand.

    names: Names, each once.
    values (p,): Values in the units of `units`.
    sigmas (p,): Prior standard deviation about the value: 0 holds the parameter, inf leaves it to the observations.
    units: ``"rad"``, ``"m"``, ``"1/m"`` or ``"1"`` of each.
    InputError: A name occurs twice, lengths differ, a value is not finite, or a sigma is negative or NaN.

    >>> tilts = Parameters(("tilt_north", "tilt_east"), [1e-3, 0.0], [np.inf, 0.0], ("rad", "rad"))
    >>> tilts.with_value({"tilt_east": 2e-3}).value("tilt_east")
    0.002
    >>> tilts.free_names
    ('tilt_north',)
    """

    names: tuple[str, ...]
    values: FloatArray
    sigmas: FloatArray
    units: tuple[str, ...]

    def __post_init__(self) -> None:
        count = len(self.names)
        repeated = sorted({name for name in self.names if self.names.count(name) > 1})
        if repeated:
            raise InputError(f"parameters: {', '.join(repeated)} occur more than once")
        object.__setattr__(self, "values", float_array("parameter values", self.values, (count,)))
        sigmas = float_array("parameter sigmas", self.sigmas, (count,), finite=False)
        if not (sigmas >= 0).all():
            worst = self.names[int(np.argmin(sigmas >= 0))]
            raise InputError(f"parameters: sigma of {worst} must be 0 (held), positive (prior) or inf (free)")
        object.__setattr__(self, "sigmas", sigmas)
        if len(self.units) != count:
            raise InputError(f"parameters: {count} names and {len(self.units)} units")

    @classmethod
    def of(cls, table: Mapping[str, Quantity]) -> "Parameters":
        """Build parameters that are all held."""
        values = [value for value, _ in table.values()]
        units = tuple(unit for _, unit in table.values())
        return cls(tuple(table), np.array(values, dtype=np.float64), np.zeros(len(table)), units)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def free(self) -> BoolArray:
        """Whether each parameter may change (sigma above 0), shape (p,)."""
        return np.asarray(self.sigmas > 0)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the parameters that may change."""
        return tuple(name for name, is_free in zip(self.names, self.free, strict=True) if is_free)

    def index(self, name: str) -> int:
        """Return the position of a name.

        InputError: There is no such parameter; the message names those that are spelled alike.
        """
        try:
            return self.names.index(name)
        except ValueError:
            near = difflib.get_close_matches(name, self.names, n=3, cutoff=0.5)
            remedy = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(self.names)}"
            raise InputError(f"parameter {name!r}: no such parameter; {remedy}") from None

    def indices(self, names: Sequence[str]) -> IntArray:
        """Return the positions of several names; errors as in `index`."""
        return np.array([self.index(name) for name in names], dtype=np.intp)

    def value(self, name: str) -> float:
        """Return the value of a name; errors as in `index`."""
        return float(self.values[self.index(name)])

    def sigma(self, name: str) -> float:
        """Return the prior sigma of a name; errors as in `index`."""
        return float(self.sigmas[self.index(name)])

    def with_values(self, values: npt.ArrayLike) -> "Parameters":
        """Return the same parameters with all values, shape (p,), replaced."""
        return replace(self, values=np.asarray(values, dtype=np.float64))

    def with_value(self, values: Mapping[str, float]) -> "Parameters":
        """Return the same parameters with some values replaced by name."""
        return replace(self, values=self._replaced(self.values, values))

    def with_sigmas(self, sigmas: Mapping[str, float]) -> "Parameters":
        """Return the same parameters with some sigmas replaced by name (0 holds, inf frees)."""
        return replace(self, sigmas=self._replaced(self.sigmas, sigmas))

    def with_only_free(self, names: Sequence[str], sigma: float = FREE) -> "Parameters":
        """Return the same parameters with these names free (or with one common prior sigma) and all others held."""
        sigmas = np.zeros(len(self))
        sigmas[self.indices(names)] = sigma
        return replace(self, sigmas=sigmas)

    def extended(self, other: "Parameters") -> "Parameters":
        """Return these parameters followed by others, such as the positions of cameras."""
        return Parameters(
            self.names + other.names,
            np.concatenate([self.values, other.values]),
            np.concatenate([self.sigmas, other.sigmas]),
            self.units + other.units,
        )

    def _replaced(self, array: FloatArray, changes: Mapping[str, float]) -> FloatArray:
        changed = array.copy()
        for name, value in changes.items():
            changed[self.index(name)] = value
        return np.asarray(freeze(changed))
