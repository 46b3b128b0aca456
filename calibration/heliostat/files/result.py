"""What the heliostats of a run share, and what a calibrated heliostat consists of."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.heliostat.diagnosis.full_diagnosis import Diagnosis
from calibration.heliostat.fitting.field_model import Field
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.fitting.model_choice import ModelChoice
from calibration.heliostat.fitting.splits import HeldOut, Misses
from calibration.heliostat.keys import HeliostatModel
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.observed import Observed
from calibration.heliostat.observations.plant import Plant
from heliogauge.doubts import Doubt
from heliogauge.validate import BoolArray, FloatArray

if TYPE_CHECKING:
    from calibration.beam.pipeline import BeamMeasurements

#: Name of the model in which values and priors come from the other heliostats of the field.
FIELD = "priors of the field"
#: Name of the model in which all parameters that are not parts of the drives move within general priors.
PRIORS_ALONE = "all with priors"
#: Name of the model of a heliostat whose fault was undone, with the fault.
REMEDY = "remedy applied"


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """What all heliostats of a run share; sent to each worker once.

    plant: Targets and site.
    model: The content of measurement.toml.
    split: The split whose residuals are reported.
    free: Usual choice of free parameters, or "auto".
    label: Method of the beams' centres in PAINT's records.
    folder: The measurement's folder; where work is done elsewhere, photos must be found there too.
    thorough: Try the model out on every split, and choose it again for each.
    field: What the heliostats of the field have in common; None where each is taken for itself.
    """

    plant: Plant
    model: HeliostatModel
    split: str
    free: str
    label: str
    folder: Path
    thorough: bool
    field: Field | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SkyMap:
    """Predicted uncertainty of the beam on one target, over the sky.

    target: Whose centre is aimed at.
    azimuths_deg, elevations_deg: Directions of the sun [deg].
    sigma_beam_rad (elevations, azimuths): Expected error of the beam [rad]; NaN where the sun never stands or the
        drives cannot point.
    extrapolated (elevations, azimuths): Whether the sun stands beyond those that were used.
    """

    target: str
    azimuths_deg: tuple[int, ...]
    elevations_deg: tuple[int, ...]
    sigma_beam_rad: FloatArray
    extrapolated: BoolArray

    @property
    def rms_beam_rad(self) -> float:
        """Expected error over the sky: root of the mean variance by solid angle [rad]; NaN where nothing is known."""
        known = np.isfinite(self.sigma_beam_rad)
        weight = np.where(known, np.cos(np.deg2rad(self.elevations_deg))[:, None], 0.0)
        if not known.any():
            return float("nan")
        return float(np.sqrt(np.sum(weight * np.nan_to_num(self.sigma_beam_rad) ** 2) / np.sum(weight)))


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatResult:
    """A calibrated heliostat.

    nominal: As it was known before.
    seen: All rows with the verdict on each.
    fit: To all usable observations.
    free: Which parameters were free.
    choice: Why; None where the user chose.
    split: The split whose residuals are reported.
    held: What came of each split that could be made: fit to one part, prediction of the other.
    diagnosis: What is wrong with the heliostat or its records.
    not_split: Why the other splits could not be made.
    sky: Predicted uncertainty over the sky; None for a plant without targets.
    beams: What was measured in photos; None where no row names one.
    doubts: What makes the numbers doubtful.
    notes: What is good to know besides.
    properties: The properties file of PAINT it came from; empty with tables.
    duration_s: Time it took [s].
    as_stated: The fit to numbers and records as they were stated, where ``fit`` is that with a remedy applied.
    observations_sha256: Hash of its observations, without what is known of it besides.
    """

    name: str
    nominal: HeliostatDesign
    seen: Observed
    fit: HeliostatFit
    free: str
    choice: ModelChoice | None
    split: str
    held: Mapping[str, HeldOut]
    diagnosis: Diagnosis
    not_split: Mapping[str, str] = field(default_factory=dict)
    sky: SkyMap | None = None
    beams: "BeamMeasurements | None" = None
    doubts: tuple[Doubt, ...] = ()
    notes: tuple[Doubt, ...] = ()
    properties: str = ""
    duration_s: float = 0.0
    as_stated: HeliostatFit | None = None
    observations_sha256: str = ""

    @property
    def main(self) -> HeldOut | None:
        """What came of the split whose residuals are reported; None where it could not be made."""
        return self.held.get(self.split)

    def misses(self, split: str) -> Misses | None:
        """Return what the rows that a split held out missed, beside what was expected; None where that is not known."""
        held = self.held.get(split)
        return None if held is None else Misses.of(held, self.fit.observations)
