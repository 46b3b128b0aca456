"""Stage 2: which parameters of a heliostat the fit may move."""

from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from calibration.heliostat.files.result import PRIORS_ALONE, Shared
from calibration.heliostat.fitting.field_fit import WithinField, field_names, fit_beside, fit_within
from calibration.heliostat.fitting.field_prior import FieldPrior
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.model_choice import ModelChoice, choose_model
from calibration.heliostat.fitting.priors import with_all_terms, with_priors, with_terms_free
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.keys import KinematicsSection
from calibration.heliostat.kinematic_model.design import HeliostatDesign, LinearActuator
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
    field: What the other heliostats say; None where that does not help.
    is_stated: Whether measurement.toml or the command line names them: then nothing else is fitted, and what is known
        of the rest only judges what the fit predicts.
    first: The robust fit of these parameters to all rows, where it was made to choose them.
    judged: The heliostat with what is usually free, where one of the usual choices of parameters is stated; else None.
    """

    design: HeliostatDesign
    name: str
    choice: ModelChoice | None = None
    field: FieldPrior | None = None
    is_stated: bool = False
    first: HeliostatFit | None = None
    judged: HeliostatDesign | None = None

    def within(self, found: HeliostatFit) -> WithinField:
        """Return a robust fit with what is known of noise and field; beside it where the parameters are stated."""
        if self.is_stated:
            return WithinField(replace(found, beside=fit_beside(found, self.field)), False)
        return fit_within(found, self.field)

    def refine(self, found: HeliostatFit) -> HeliostatFit:
        """Return the fit of `within`."""
        return self.within(found).fit


def choose_free_parameters(
    nominal: HeliostatDesign, observations: Observations, shared: Shared, options: FitOptions
) -> FreeParameters:
    """Choose the parameters that the fit may move.

    nominal: The heliostat as it is known before.
    """
    kinematics = shared.model.kinematics
    usual = starting_design(nominal)
    model = shared.field.model(field_names(usual), unit_groups(nominal)) if shared.field is not None else None
    field = None if model is None else model.prior(nominal.name)
    if shared.free == AUTO and frees_parameters(kinematics):
        free = kinematics.free
        name = free if isinstance(free, str) else "as in measurement.toml"
        judged = _with_asked(usual, kinematics) if isinstance(free, str) else None
        return FreeParameters(nominal, name, field=field, is_stated=True, judged=judged)
    if shared.free != AUTO:
        chosen = nominal.with_free(shared.free)
        chosen = with_terms_free(chosen, asked_terms(chosen, kinematics))
        judged = _with_asked(usual, kinematics)
        return FreeParameters(chosen, shared.free, field=field, is_stated=True, judged=judged)
    first = fit(usual, observations, options)
    known = FreeParameters(usual, PRIORS_ALONE, first=first)
    if is_hopeless(first):
        # What is usual is no help to a heliostat that something is wrong with.
        return known
    if field is not None:
        return replace(known, field=field)
    if not shared.thorough:
        return known
    choice = choose_model(nominal, observations, options)
    return FreeParameters(choice.design, choice.best, choice)


def _with_asked(design: HeliostatDesign, kinematics: KinematicsSection) -> HeliostatDesign:
    return with_terms_free(design, asked_terms(design, kinematics))


def starting_design(nominal: HeliostatDesign) -> HeliostatDesign:
    """Return a heliostat with everything that a field can know: what is usually free is, within its prior."""
    usual = with_priors(nominal).parameters.free_names
    return with_priors(with_all_terms(nominal), usual)


def unit_groups(nominal: HeliostatDesign) -> dict[str, str]:
    """Return by what heliostats may be alike: their drives' delivered numbers, and the row they stand in.

    nominal: As it was delivered; the letters that its name begins with are its row.
    """
    drives = []
    for drive in nominal.drives:
        own = (drive.offset, drive.pivot_radius, drive.increment) if isinstance(drive, LinearActuator) else ()
        sense = drive.clockwise if isinstance(drive, LinearActuator) else drive.rad_per_reading
        drives.append((sense, *(f"{nominal.parameters.value(name):.5g}" for name in own)))
    return {"drives": repr(drives), "row": "".join(takewhile(str.isalpha, nominal.name))}


def is_hopeless(found: HeliostatFit) -> bool:
    """Whether something is wrong that no choice of parameters mends: trying them all would only take time."""
    angles = found.residuals.beam_angle_rad[np.isfinite(found.residuals.beam_angle_rad)]
    return bool(angles.size) and float(np.median(angles)) > _HOPELESS_RAD
