"""Frames to display, as files: fringes, bright and dark, grey steps, and the tables that describe them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from deflectometry.setup.patterns import Axis, DisplayLevels, FringePattern, make_pattern, render_frames, response_table
from heliogauge import __version__
from heliogauge.errors import InputError
from heliogauge.images.photos import write_image
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.writer import dump_toml, write_text
from heliogauge.results.tables import read_number_columns
from heliogauge.results.whole_folder import FolderKind, WholeFolder
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import positive

PATTERN_FILE = "pattern.toml"
GREY_FILE = "grey.toml"
PATTERNS = FolderKind(content="patterns", mark=PATTERN_FILE, strangers=frozenset({"measurement.toml"}))
#: Below four pixels a period the display shows its own raster rather than a sinusoid (modulation 0.9, steps of 90 deg).
_LEAST_PERIOD_PX = 4.0


@dataclass(frozen=True, slots=True)
class DisplayOptions:
    """The display and how its range is used.

    width_px, height_px: Size of the displayed image [px].
    bits: Bit depth of the frames, 8 or 16.
    level_min, level_max: Levels of the darkest and the brightest fringe as shares of the display's range; None: the
        whole range, or the range that the response covers.
    response_file: Response of camera and display (columns camera_dn, display_level); the fringes are compensated
        for it.
    response_full_level: The display_level of that file that is full range: 1 for files of this software, 255 for
        OpenCSP's.
    """

    width_px: int
    height_px: int
    bits: int = 8
    level_min: float | None = None
    level_max: float | None = None
    response_file: Path | None = None
    response_full_level: float = 1.0


@dataclass(frozen=True, slots=True)
class PatternOptions:
    """What to show.

    periods: Fringe periods over the displayed image, in both directions.
    steps: Frames of each period, 360 deg / steps apart.
    first: Which direction comes first.
    grey_steps: Number of uniform grey levels for the calibration of the response.
    """

    periods: tuple[float, ...] = (0.9, 3.9, 15.9, 63.9)
    steps: int = 4
    first: Axis = Axis.Y
    grey_steps: int = 33


def write_patterns(
    folder: Path,
    display: DisplayOptions,
    options: PatternOptions | None = None,
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> FringePattern:
    """Write all frames for a display, and the tables for the measurement files; the folder is whole or not there.

    Parameters
    ----------
    folder : Path
        Where to write; absent or empty.
    display : DisplayOptions
        The display.
    options : PatternOptions, optional
        What to show.
    force : bool, optional
        Replace earlier patterns.
    progress : Progress, optional
        Reports each frame.

    Returns
    -------
    FringePattern
        The fringes, in the order of their files.

    Raises
    ------
    InputError
        The folder holds something, a value out of range, a response that does not cover the levels, or fringes too
        fine for the display.
    """
    options, progress = options or PatternOptions(), progress or SilentProgress()
    with WholeFolder(folder, PATTERNS, force=force) as working:
        pattern = make_pattern(options.periods, options.periods, options.steps, options.first)
        _refuse_fine_fringes(pattern, display)
        levels = display_levels(display)
        grey = grey_levels(options.grey_steps, display.bits)
        names = [f"fringe_{index:03d}.png" for index in range(pattern.n_frames)]
        with progress.stage("write frames", len(names) + 2 + len(grey)) as stage:
            frames = render_frames(pattern, display.width_px, display.height_px, levels)
            for name, frame in zip(names, frames, strict=True):
                write_image(working / name, frame)
                stage.advance()
            # Black is the display's darkest level, white the fringes' brightest, so that one exposure suits all frames.
            full = 2**display.bits - 1
            uniform = {"dark.png": 0, "bright.png": round(levels.maximum * full)}
            uniform |= {f"grey_{index:03d}.png": level for index, level in enumerate(grey)}
            for name, level in uniform.items():
                write_image(working / name, _uniform_frame(display, level))
                stage.advance()
        _write_tables(working, pattern, display, levels, grey)
    return pattern


def display_levels(display: DisplayOptions) -> DisplayLevels:
    """Return the range and the compensation for a display.

    Returns: What `deflectometry.setup.patterns.render_frames` takes.
    InputError: Levels out of range or beyond what the response covers.
    """
    if display.bits not in (8, 16):
        raise InputError(f"bits: 8 or 16 is needed (what PNG files have), not {display.bits}")
    if display.response_file is None:
        lowest, highest = 0.0, 1.0
        table = np.array([0.0, 1.0])
    else:
        camera_dn, level = read_number_columns(display.response_file, ("camera_dn", "display_level"))
        level = level / positive("response_full_level", display.response_full_level, "display levels")
        if level.size and level.max() > 1 + 1e-9:
            raise InputError(
                f"{display.response_file}: display_level goes up to {level.max() * display.response_full_level:g}, "
                f"above full range {display.response_full_level:g}; say what level is full range with "
                "response_full_level (255 for levels of 8 bit)"
            )
        table = response_table(camera_dn, level)
        # Rounding of a share written as text must not cut off the ends.
        lowest, highest = max(float(level[0]), 0.0), min(float(level[-1]), 1.0)
    minimum = lowest if display.level_min is None else display.level_min
    maximum = highest if display.level_max is None else display.level_max
    if display.response_file is not None and (minimum < lowest - 1e-9 or maximum > highest + 1e-9):
        raise InputError(
            f"levels {minimum:g} to {maximum:g}: {display.response_file} covers {lowest:.4g} to {highest:.4g} only; "
            "choose level_min and level_max within, or calibrate the response over more levels"
        )
    return DisplayLevels(minimum, maximum, display.bits, table)


def grey_levels(count: int, bits: int) -> list[int]:
    """Return uniform grey levels over the display's whole range.

    Returns: Levels, ascending from 0 to the brightest [display DN].
    InputError: Fewer than 3, or more than there are levels of 8 bit.

    >>> grey_levels(5, 8)
    [0, 64, 128, 191, 255]
    """
    if not 3 <= count <= 256:
        raise InputError(f"grey steps: 3 to 256 levels are needed, not {count}")
    levels: list[int] = np.rint(np.linspace(0, 2**bits - 1, count)).astype(int).tolist()
    return levels


def _refuse_fine_fringes(pattern: FringePattern, display: DisplayOptions) -> None:
    sizes = {Axis.X: ("width", display.width_px), Axis.Y: ("height", display.height_px)}
    for fringes in pattern.sets:
        name, size = sizes[fringes.axis]
        period_px = positive(f"{name}_px", size, "px") / fringes.periods
        if period_px < _LEAST_PERIOD_PX:
            raise InputError(
                f"{fringes.periods:g} periods over the {name} of {size} px are {period_px:.2g} px each; at least "
                f"{_LEAST_PERIOD_PX:g} px are needed: at most {size / _LEAST_PERIOD_PX:g} periods"
            )


def _uniform_frame(display: DisplayOptions, level: int) -> npt.NDArray[Any]:
    dtype = np.uint8 if display.bits == 8 else np.uint16
    return np.full((display.height_px, display.width_px), level, dtype=dtype)


def _write_tables(
    folder: Path, pattern: FringePattern, display: DisplayOptions, levels: DisplayLevels, grey: list[int]
) -> None:
    compensated, leave_out = "", ""
    if display.response_file is not None:
        compensated = f", compensated for {display.response_file.name}"
        leave_out = "# The camera sees these fringes as sinusoids: leave response_file out of [screen].\n"
    size = f"{display.width_px} x {display.height_px} px, {display.bits} bit"
    sets = [
        {"axis": str(one.axis), "periods": one.periods, "steps_deg": np.degrees(one.steps_rad).round(9).tolist()}
        for one in pattern.sets
    ]
    images = {"fringes": "fringe_*.png", "dark": "dark.png", "bright": "bright.png"}
    text = (
        f"# {pattern.n_frames} fringe frames of {size}, levels {levels.minimum:.4g} to {levels.maximum:.4g} of the "
        f"display's range{compensated}; heliogauge {__version__}.\n"
        "# Show fringe_000.png, fringe_001.png ... in full screen, one image pixel on one display pixel, and take a\n"
        "# photograph of each; then of bright.png and dark.png, with the same exposure. These tables go into\n"
        "# measurement.toml as they are; [images] names the photographs: call them like the frames, or list their own\n"
        "# names in this order.\n"
        f"{leave_out}\n"
    )
    write_text(folder / PATTERN_FILE, text + dump_toml({"pattern": {"set": sets}, "images": images}))
    content = {
        "kind": "response",
        "name": f"display of {size}",
        "display": {"levels": grey, "full_level": 2**display.bits - 1},
        "images": {"grey": "grey_*.png"},
    }
    parse_measurement(content, Path(GREY_FILE))
    text = (
        "# Show grey_000.png, grey_001.png ... as the fringes, photograph each with the exposure of the fringes, and\n"
        "# put this file beside the photographs as measurement.toml; then `heliogauge screen measure`.\n\n"
    )
    write_text(folder / GREY_FILE, text + dump_toml(content))
