"""Stage 6: what makes the numbers of a heliostat doubtful, and what is only good to know."""

from collections.abc import Iterator

import numpy as np

from calibration.heliostat.files.result import Shared
from calibration.heliostat.files.sources import HeliostatTask
from calibration.heliostat.files.store_paint import parse_properties
from calibration.heliostat.fitting.field_fit import WithinField
from calibration.heliostat.fitting.field_prior import FieldPrior
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.fitting.splits import HeldOut
from calibration.heliostat.observations.observed import Observed
from calibration.heliostat.observations.rows import Rows
from calibration.heliostat.pipeline.trials import Trials
from heliogauge.doubts import Doubt, Severity

#: More readings than this beyond the actuators' geometry are not slips of single rows.
_FEW_BEYOND = 0.02
#: More refused rows than this make the rest doubtful too.
_FEW_REFUSED = 0.1


def collect_doubts(
    task: HeliostatTask,
    seen: Observed,
    within: WithinField,
    field: FieldPrior | None,
    trials: Trials,
    shared: Shared,
) -> Iterator[Doubt]:
    """Yield what came up in the trials, on reading and in the fit to all rows; what is only good to know as notes.

    field: What the other heliostats say of it; None where that does not help.
    """
    result = within.fit
    main = trials.held.get(shared.split)
    if main is not None and main.beyond is not None:
        # Extrapolation is reported before any number.
        yield main.beyond.prefixed(f"split {main.split.name}")
    if task.properties:
        yield from parse_properties(task.properties, task.name).doubts
    beyond = ~result.residuals.computable
    if np.count_nonzero(beyond) > _FEW_BEYOND * len(beyond):
        yield Doubt(
            "readings_beyond_actuators",
            f"{np.count_nonzero(beyond)} of {len(beyond)} readings cannot be reached with the actuators as delivered: "
            "their numbers (strokes, offsets, radii) are wrong for this heliostat",
            {"beyond_count": int(np.count_nonzero(beyond)), "readings_count": len(beyond)},
            Severity.SERIOUS,
        )
    yield from refused_rows(seen.rows)
    if within.by_field and field is not None:
        common = ", ".join(field.names)
        text = f"{field.heliostats} other heliostats of the field give what is usual: values and priors of {common}"
        yield Doubt("priors_of_the_field", text, {"heliostats_count": field.heliostats}, Severity.NOTE)
    yield from _missing_sigmas(seen, shared.model.evaluation.spot_sigma_mm)
    yield from result.doubts
    if main is not None:
        yield from _rejected_tests(main, result)
    if main is None and shared.split in trials.not_made:
        text = f"nothing was held out: {trials.not_made[shared.split]}"
        yield Doubt("nothing_held_out", text, severity=Severity.NOTE)


def _rejected_tests(main: HeldOut, result: HeliostatFit) -> Iterator[Doubt]:
    """Yield how the trial comes out without the test rows that the fit to all rows refuses.

    Nobody knows them beforehand, so they count in the trial; one of 30 mrad among forty makes 5 mrad of 1.
    """
    bad = main.split.test & result.rejected
    if not bad.any():
        return
    both = main.split.train | main.split.test
    angles = np.full(both.size, np.nan)
    angles[both] = main.residuals.beam_angle_rad
    good = angles[main.split.test & ~bad]
    if not np.isfinite(good).any():
        return
    rms, count, tested = float(np.sqrt(np.nanmean(good**2))), int(bad.sum()), int(main.split.test.sum())
    yield Doubt(
        "test_rows_rejected",
        f"split {main.split.name}: {count} of {tested} test rows are refused by the fit to all rows; without them the "
        f"beam is predicted to {1e3 * rms:.2f} mrad RMS, with them to {1e3 * main.test.beam_rms_rad:.2f}",
        {"rejected_count": count, "without_rejected_rad": rms},
        Severity.NOTE,
    )


def refused_rows(rows: Rows) -> Iterator[Doubt]:
    """Yield which rows were left out for each reason; a few are only good to know, unless they cannot be read.

    rows: As they were read. A row that is cut off or unreadable shows that something happened to the file.
    """
    refused = [flag for flag in rows.flags if flag]
    for flag in dict.fromkeys(refused):
        first, count = rows.flags.index(flag), refused.count(flag)
        yield Doubt(
            "rows_left_out",
            f"{count} of {len(rows)} rows left out ({flag}), the first: {rows.ids[first]}: {rows.reasons[first]}",
            {"left_out_count": count, "rows_count": len(rows)},
            Severity.DOUBT if flag == "unreadable" or count > _FEW_REFUSED * len(rows) else Severity.NOTE,
        )


def _missing_sigmas(seen: Observed, spot_sigma_mm: float) -> Iterator[Doubt]:
    """Yield what was taken where observations come without sigmas."""
    rows = seen.rows
    if not seen.has_sigmas:
        yield Doubt(
            "observations_without_sigma",
            f"the observations come without sigmas: {spot_sigma_mm:g} mm is taken for beams, "
            "and its scale estimated from the residuals",
            {"taken_mm": spot_sigma_mm},
            Severity.NOTE,
        )
    elif empty := _without_sigma(rows):
        yield Doubt(
            "rows_without_sigma",
            f"{len(empty)} of {len(rows)} rows have no sigma_mm beside others that have one, the first: {empty[0]}: "
            f"{spot_sigma_mm:g} mm is taken for them",
            {"rows_count": len(empty), "taken_mm": spot_sigma_mm},
        )


def _without_sigma(rows: Rows) -> tuple[str, ...]:
    """Return the usable beams of a table whose own cell of ``sigma_mm`` is empty; none where both axes have columns."""
    if "sigma_mm" not in rows.numbers or "sigma_x_mm" in rows.numbers:
        return ()
    given, kinds = rows.numbers["sigma_mm"], rows.text("kind", "beam")
    return tuple(
        rows.ids[row]
        for row in np.flatnonzero(np.isnan(given)).tolist()
        if kinds[row] == "beam" and not rows.flags[row]
    )
