"""What was seen of a heliostat: any mixture of beams, drones, cameras, lamps, normals and points.

Frame of the field: x east, y north, z up [m]. Directions to the sun are apparent (refracted). A row is one observation
at one pair of readings.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.kinematic_model.parameters import Parameters
from calibration.heliostat.observations.beam_observations import BeamSpots, DroneSightings, SunInCamera
from calibration.heliostat.observations.mirror_observations import LampSightings, MirrorNormals, MirrorPoints
from calibration.heliostat.observations.pointings import MountedCamera, Place, Pointings, joined_parameters
from heliogauge.errors import InputError
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray, TimeArray

__all__ = [
    "BeamSpots",
    "DroneSightings",
    "Group",
    "LampSightings",
    "MirrorNormals",
    "MirrorPoints",
    "MountedCamera",
    "Observations",
    "Place",
    "Pointings",
    "SunInCamera",
]

Group: TypeAlias = BeamSpots | SunInCamera | DroneSightings | LampSightings | MirrorNormals | MirrorPoints


@dataclass(frozen=True, slots=True, eq=False)
class Observations(ShortRepr):
    """Any mixture of observations of one heliostat.

    groups: Groups of one kind each; their rows follow one another.
    kept: What was worked out of them for one design (`ObservationModel`), by its numbers.
    InputError: There is no group.
    """

    groups: tuple[Group, ...]
    kept: dict[bytes, Any] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        if not self.groups:
            raise InputError("observations: at least one group is needed")

    def __len__(self) -> int:
        return sum(len(group) for group in self.groups)

    @property
    def row(self) -> IntArray:
        """Identity of each row, shape (n,)."""
        return np.concatenate([group.pointings.row for group in self.groups])

    @property
    def time(self) -> TimeArray:
        """UTC of each row, shape (n,)."""
        return np.concatenate([group.pointings.time for group in self.groups])

    @property
    def readings(self) -> FloatArray:
        """Readings of each row, shape (n, 2)."""
        return np.concatenate([group.pointings.readings for group in self.groups])

    @property
    def approach(self) -> FloatArray | None:
        """Direction of the last moves, shape (n, 2), 0 where unknown; None if no row knows it."""
        if all(group.pointings.approach is None for group in self.groups):
            return None
        known = [group.pointings.approach for group in self.groups]
        parts = [np.zeros((len(g), 2)) if one is None else one for g, one in zip(self.groups, known, strict=True)]
        return np.concatenate(parts)

    @property
    def kind(self) -> tuple[str, ...]:
        """Kind of each row."""
        return tuple(group.kind for group in self.groups for _ in range(len(group)))

    @property
    def label(self) -> tuple[str, ...]:
        """Target, camera, lamp or point of each row."""
        return tuple(label for group in self.groups for label in group.label)

    @property
    def sun(self) -> FloatArray:
        """Direction to the sun of each row, shape (n, 3); NaN for kinds that do without."""
        return np.concatenate([group.sun_or_nan for group in self.groups])

    @property
    def n_components(self) -> IntArray:
        """Number of residuals of each row, shape (n,)."""
        return np.concatenate([np.full(len(group), group.n_components, dtype=np.int64) for group in self.groups])

    def select(self, mask: npt.ArrayLike) -> "Observations":
        """Return the rows of a mask, shape (n,); groups stay where they are, also when empty.

        InputError: The mask has another length.
        """
        chosen = np.asarray(mask, dtype=np.bool_)
        if chosen.shape != (len(self),):
            raise InputError(f"mask: shape ({len(self)},) is needed, not {chosen.shape}")
        edges = np.cumsum([0, *(len(group) for group in self.groups)])
        if chosen.all():
            return self
        masks = [chosen[a:b] for a, b in pairwise(edges.tolist())]
        found = Observations(tuple(group.select(own) for group, own in zip(self.groups, masks, strict=True)))
        for key, known in self.kept.items():
            found.kept[key] = tuple(one.select(own) for one, own in zip(known, masks, strict=True))
        return found

    def extra_parameters(self, design: HeliostatDesign) -> Parameters:
        """Return what the observations bring besides the heliostat's own numbers, without those it already has.

        InputError: Two groups contradict each other about a camera or target.
        """
        extra = joined_parameters(group.extra_parameters(design) for group in self.groups if len(group))
        new = np.array([name not in design.parameters.names for name in extra.names], dtype=np.bool_)
        names = tuple(name for name, is_new in zip(extra.names, new, strict=True) if is_new)
        units = tuple(unit for unit, is_new in zip(extra.units, new, strict=True) if is_new)
        return Parameters(names, extra.values[new], extra.sigmas[new], units)
