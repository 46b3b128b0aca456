"""Stage 6: what makes the numbers of a heliostat doubtful, and what is only good to know."""

from dataclasses import dataclass

import numpy as np

from calibration.heliostat.files.result import Shared
from calibration.heliostat.files.sources import HeliostatTask
from calibration.heliostat.files.store_paint import parse_properties
from calibration.heliostat.fitting.fit_result import HeliostatFit
from calibration.heliostat.observations.observed import Observed
from calibration.heliostat.observations.rows import Rows
from calibration.heliostat.pipeline.trials import Trials

#: More readings than this beyond the actuators' geometry are not slips of single rows.
_FEW_BEYOND = 0.02
#: More refused rows than this make the rest doubtful too.
_FEW_REFUSED = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Remarks:
    """What the user must hear (`doubts`) and may hear (`notes`)."""

    doubts: tuple[str, ...]
    notes: tuple[str, ...]


def collect_remarks(
    task: HeliostatTask, seen: Observed, result: HeliostatFit, trials: Trials, shared: Shared
) -> Remarks:
    """Collect what came up on reading, in the fit to all rows and in the trials."""
    doubts: list[str] = []
    notes: list[str] = []
    if task.properties:
        doubts += list(parse_properties(task.properties, task.name).doubts)
    beyond = ~result.residuals.computable
    if np.count_nonzero(beyond) > _FEW_BEYOND * len(beyond):
        doubts.append(
            f"{np.count_nonzero(beyond)} of {len(beyond)} readings cannot be reached with the actuators as delivered: "
            "their numbers (strokes, offsets, radii) are wrong for this heliostat"
        )
    rows = seen.rows
    refused = [flag for flag in rows.flags if flag]
    for flag in dict.fromkeys(refused):
        first, count = rows.flags.index(flag), refused.count(flag)
        text = f"{count} of {len(rows)} rows left out ({flag}), the first: {rows.ids[first]}: {rows.reasons[first]}"
        (doubts if count > _FEW_REFUSED * len(rows) else notes).append(text)
    if shared.population is not None and shared.population.knows(task.name):
        others = len(set(shared.population.heliostats) - {task.name})
        common = ", ".join(shared.population.names)
        notes.append(f"{others} other heliostats of the field say what is usual: values and priors of {common}")
    spot_sigma_mm = shared.model.evaluation.spot_sigma_mm
    if not seen.has_sigmas:
        notes.append(
            f"the observations come without sigmas: {spot_sigma_mm:g} mm is taken for beams, "
            "and its scale estimated from the residuals"
        )
    elif empty := _without_sigma(rows):
        doubts.append(
            f"{len(empty)} of {len(rows)} rows have no sigma_mm beside others that have one, the first: {empty[0]}: "
            f"{spot_sigma_mm:g} mm is taken for them"
        )
    for text in result.doubts:
        # That the scale of the sigmas is estimated is no fault of the heliostat.
        (notes if text.startswith("sigma of ") else doubts).append(text)
    main = trials.held.get(shared.split)
    if main is not None:
        # Extrapolation is reported before any number; the rest are doubts of the fit to the train rows.
        doubts = [text for text in main.doubts if text.startswith("split ")] + doubts
    elif shared.split in trials.not_made:
        notes.append(f"nothing was held out: {trials.not_made[shared.split]}")
    return Remarks(tuple(dict.fromkeys(doubts)), tuple(dict.fromkeys(notes)))


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
