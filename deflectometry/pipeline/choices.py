"""How a measurement is evaluated: what the caller may override, and what then holds."""

from dataclasses import dataclass

from deflectometry.keys import BenchMeasurement
from deflectometry.shape.smooth_shape import Align
from heliogauge.errors import InputError
from heliogauge.slopes.removal import Removal


@dataclass(frozen=True, slots=True)
class Options:
    """Choices that override those of measurement.toml.

    Parameters
    ----------
    align : Align or None
        Orientation that the slopes refer to; None as measurement.toml says.
    grid_step_mm : float or None
        Grid step of the maps [mm]; None as measurement.toml says, else 0.4 to 1 of the spacing of the pixels.
    remove : Removal or None
        What is taken out of the maps; None as measurement.toml says.
    strict : bool
        Refuse frames that had to be mended or left out.
    jobs : int or None
        Threads that decode images; None for all processors.
    """

    align: Align | None = None
    grid_step_mm: float | None = None
    remove: Removal | None = None
    strict: bool = False
    jobs: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Choices:
    """How the slopes are to be reported.

    align: Orientation the slopes refer to.
    grid_step_m: Grid step of the maps; 0 takes 0.4 to 1 of the spacing of the pixels [m].
    removal: What is taken out of the maps.
    """

    align: Align = Align.NORMAL
    grid_step_m: float = 0.0
    removal: Removal = Removal.NOTHING


def build_choices(measurement: BenchMeasurement, options: Options) -> Choices:
    """Return what measurement.toml says, with the options in its place where they are given."""
    section = measurement.model.evaluation
    step_mm = options.grid_step_mm if options.grid_step_mm is not None else section.grid_step_mm
    if step_mm is not None and not step_mm > 0:
        raise InputError(f"grid step: a positive number of mm is needed, not {step_mm}")
    return Choices(
        align=options.align or Align(section.align),
        grid_step_m=0.0 if step_mm is None else step_mm * 1e-3,
        removal=options.remove or Removal(section.remove),
    )
