"""Which heliostats a run is about, and what they share."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from typing import get_args

from calibration.heliostat.files.field_folder import check_names
from calibration.heliostat.files.result import Shared
from calibration.heliostat.files.sources import Source, open_source
from calibration.heliostat.fitting.field_model import MOST_LEARNED_FROM, learn_field
from calibration.heliostat.keys import HeliostatMeasurement, Label, Split
from calibration.heliostat.pipeline.free_parameters import AUTO
from calibration.heliostat.pipeline.one_heliostat import FirstLook, look_first
from heliogauge.errors import InputError
from heliogauge.running.progress import Progress
from heliogauge.running.scale import Workers, run_each

#: Up to so many heliostats every split is made and the model chosen by trial, unless the user chooses otherwise: a
#: second each instead of a tenth.
THOROUGH_UP_TO = 25
#: Of fewer none can be left out to see whether the others predict it.
FEWEST_OF_A_FIELD = 3
#: Heliostats that are worth a process of their own, which takes a second to start: quick ones, thorough ones.
WORTH = {False: 16, True: 1}


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """What a run is about: where heliostats come from, which of them, and what they share."""

    source: Source
    names: tuple[str, ...]
    shared: Shared


def choose(
    measurement: HeliostatMeasurement,
    *,
    split: str | None,
    model: str | None,
    label: str | None,
    only: str | None,
    thorough: bool | None,
) -> Campaign:
    """Look at a measurement: which heliostats, and what they share.

    InputError: The measurement cannot be meant, or no heliostat has a name that is asked for.
    """
    source = open_source(measurement)
    names = tuple(_asked_for(source.names, only))
    check_names(names)
    evaluation = measurement.model.evaluation
    shared = Shared(
        plant=source.plant,
        model=measurement.model,
        split=_one_of("split", split, get_args(Split)) or evaluation.split,
        free=model or evaluation.model or AUTO,
        label=_one_of("label", label, get_args(Label)) or evaluation.label,
        folder=measurement.folder.absolute(),
        thorough=len(names) <= THOROUGH_UP_TO if thorough is None else thorough,
    )
    return Campaign(source, names, shared)


def with_field(campaign: Campaign, workers: Workers, progress: Progress) -> Campaign:
    """Learn what the heliostats of a field have in common.

    workers: Who works.
    Returns: With the field; as it was for one heliostat, or for beams that are only measured yet. Of a large field some
        hundred heliostats, evenly spread over it, are looked at first.
    """
    shared, names = campaign.shared, campaign.names
    if shared.model.images or len(names) < FEWEST_OF_A_FIELD:
        return campaign
    count = min(len(names), MOST_LEARNED_FROM)
    chosen = tuple(names[index * len(names) // count] for index in range(count))
    found: dict[str, FirstLook] = {}
    processes = workers.processes(count, worth=WORTH[False])
    with progress.stage("what the field has in common", count) as stage:
        for done in run_each(look_first, shared, campaign.source.tasks(chosen), workers=workers, processes=processes):
            if isinstance(done.outcome, FirstLook):
                found[done.task.name] = done.outcome
            stage.advance()
        looks = [found[name] for name in chosen if name in found]
        if len(looks) < FEWEST_OF_A_FIELD:
            return campaign
        scales = {name: sigma for look in looks for name, sigma in look.scales.items()}
        field = learn_field([look.unit for look in looks], scales)
    return replace(campaign, shared=replace(shared, field=field))


def _one_of(name: str, value: str | None, known: tuple[str, ...]) -> str | None:
    if value is not None and value not in known:
        near = get_close_matches(value, known, n=1)
        raise InputError(
            f"{name}={value}: " + (f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}")
        )
    return value


def _asked_for(names: tuple[str, ...], only: str | None) -> Iterator[str]:
    if only is None:
        yield from names
        return
    patterns = [text.strip() for text in only.split(",")]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise InputError(f"only={pattern}: no heliostat of that name; there are {', '.join(names[:8])}")
    yield from (name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns))
