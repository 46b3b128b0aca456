"""Stage 2: which parameters of a heliostat the fit may move."""

from dataclasses import dataclass

import numpy as np

from calibration.heliostat.files.result import FIELD, Shared
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.model_choice import ModelChoice, choose_model
from calibration.heliostat.fitting.population import with_population
from calibration.heliostat.fitting.priors import with_priors, with_terms_free
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.observations import Observations
from calibration.heliostat.pipeline.nominal_design import asked_terms, frees_parameters

AUTO = "auto"
#: A median farther from the best fit than this is no matter of which parameters are free [rad of the beam].
_HOPELESS_RAD = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class FreeParameters:
    """Which parameters are free.

    design: The heliostat with these parameters free, within their priors where they have any.
    name: What the choice is called.
    choice: How it was made from trials; None where it was not.
    """

    design: HeliostatDesign
    name: str
    choice: ModelChoice | None = None


def choose_free_parameters(
    nominal: HeliostatDesign, observations: Observations, shared: Shared, options: FitOptions
) -> FreeParameters:
    """Choose the parameters that the fit may move.

    nominal: The heliostat as it is known before.
    """
    kinematics = shared.model.kinematics
    if shared.free == AUTO and frees_parameters(kinematics):
        free = kinematics.free
        return FreeParameters(nominal, free if isinstance(free, str) else "as in measurement.toml")
    if shared.free != AUTO:
        chosen = nominal.with_free(shared.free)
        return FreeParameters(with_terms_free(chosen, asked_terms(chosen, kinematics)), shared.free)
    known = FreeParameters(with_priors(nominal), "all with priors")
    if not shared.thorough:
        return known
    if shared.population is not None and shared.population.knows(nominal.name):
        usual = with_population(known.design, shared.population)
        # What is usual is no help to a heliostat that something is wrong with.
        return known if is_hopeless(fit(usual, observations, options)) else FreeParameters(usual, FIELD)
    if is_hopeless(fit(known.design, observations, options)):
        return known
    choice = choose_model(nominal, observations, options)
    return FreeParameters(choice.design, choice.best, choice)


def is_hopeless(found: HeliostatFit) -> bool:
    """Whether something is wrong that no choice of parameters mends: trying them all would only take time."""
    angles = found.residuals.beam_angle_rad[np.isfinite(found.residuals.beam_angle_rad)]
    return bool(angles.size) and float(np.median(angles)) > _HOPELESS_RAD
