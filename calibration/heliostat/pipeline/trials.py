"""Stage 3: the model is fitted to a part of the observations and predicts the rest, split by split."""

from dataclasses import dataclass, replace

from calibration.heliostat.files.result import Shared
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.model_choice import choose_model
from calibration.heliostat.fitting.splits import SPLIT_NAMES, HeldOut, held_out, make_split
from calibration.heliostat.kinematic_model.design import HeliostatDesign
from calibration.heliostat.observations.observations import Observations
from calibration.heliostat.observations.rows import Rows
from calibration.heliostat.pipeline.free_parameters import FreeParameters
from heliogauge.errors import EstimationError, InputError


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """What came of each split.

    held: Fit to one part and prediction of the other, by the name of the split.
    not_made: Why the other splits could not be made.
    """

    held: dict[str, HeldOut]
    not_made: dict[str, str]


def try_out(
    nominal: HeliostatDesign,
    free: FreeParameters,
    observations: Observations,
    rows: Rows,
    shared: Shared,
    options: FitOptions,
    *,
    hopeless: bool,
    near: HeliostatFit,
) -> Trials:
    """Try the model out on the split that is reported; thorough runs on every split.

    nominal: The heliostat as it is known before.
    rows: All rows, whose column "split" may name the parts.
    near: Robust fit to all rows.
    hopeless: Something is wrong with heliostat or records; the other splits would only take time.
    """
    # The choice is part of what is tried out: it is made again from the training rows alone.
    design, chooser = (free.design, None) if free.choice is None else (nominal, choose_model)
    others = SPLIT_NAMES if shared.thorough and not hopeless else ()
    options = replace(options, restarts=0) if hopeless else options
    trials = Trials({}, {})
    for name in dict.fromkeys((shared.split, *others)):
        column = None
        if name == "column":
            parts = rows.text("split", "train")
            column = tuple(parts[row] for row in observations.row.tolist())
        try:
            split = make_split(observations, name, seed=shared.model.evaluation.random_seed, column=column)
            trials.held[name] = held_out(
                design,
                observations,
                split,
                options,
                chooser=chooser,
                refine=None if hopeless else free.refine,
                near=None if hopeless else near,
            )
        except (EstimationError, InputError) as error:
            trials.not_made[name] = str(error)
    return trials
