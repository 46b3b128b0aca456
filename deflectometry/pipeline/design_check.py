"""Whether a scan is of its design and of enough of it: slopes too far off, bent otherwise, few, or counted twice."""

from collections.abc import Iterator, Mapping

import numpy as np

from heliogauge.doubts import Doubt, Severity
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.mounts import LEAST_SHARE

#: Root mean square slope error that no mirror for sunlight has: its beam would be 40 mrad wide.
_GROSS_MRAD = 10.0
#: Deviation whose cause is the curvature of the whole mirror: the best-fit quadratic takes away more than two thirds.
_SHAPE_MRAD = 1.0
_SHAPE_SHARE = 0.3
#: A curvature that differs by half of itself is another design, not an error of manufacture.
_OTHER_DESIGN, _SURE = 0.5, 10.0


def is_other_shape(error_rad: float, rest_rad: float) -> bool:
    """Return whether slopes are of another shape than their design.

    error_rad, rest_rad: RMS slope error against the design, and what another shape leaves of it [rad].
    """
    return 1e3 * error_rad > _SHAPE_MRAD and rest_rad < _SHAPE_SHARE * error_rad


def off_design(numbers: Mapping[str, float | int | None], to_check: str) -> Iterator[Doubt]:
    """Yield what makes the design doubtful.

    numbers: Headline numbers of the mirror.
    to_check: What else makes slopes so large, for the user to check.
    """
    error, rest = (1e3 * _number(numbers, f"sd_{left}_rad") for left in ("tilt_removed", "best_quadratic"))
    # In curvatures, which a flat mirror has, too.
    lengths = ", ".join(f"1/f in {axis} {2 * _number(numbers, f'curvature_{axis}_per_m'):.4g} 1/m" for axis in "xy")
    if error > _GROSS_MRAD:
        yield Doubt(
            "slopes_too_far_off_design",
            f"the slopes are {error:.1f} mrad RMS off the design (best fit: {lengths}): too far for any solar mirror; "
            f"check the design and its unit, {to_check}",
            {"slope_error_mrad": error},
            Severity.SERIOUS,
        )
    elif is_other_shape(1e-3 * error, 1e-3 * rest):
        yield Doubt(
            "design_curvature_is_not_the_mirrors",
            f"the design's curvature is not the mirror's: of {error:.2f} mrad RMS of slope error {rest:.2f} mrad are "
            f"left with {lengths}; check the design and its focal length or radius [m]",
            {"slope_error_mrad": error, "best_quadratic_mrad": rest},
        )


def other_design(numbers: Mapping[str, float | int | None], as_measured: SlopeMap, to_check: str) -> Iterator[Doubt]:
    """Yield the axes in which the mirror has another focal length than its design, or else what `off_design` finds.

    For instruments that measure all over the mirror without a start from the design.
    """
    x, y = np.meshgrid(as_measured.x_m, as_measured.y_m)
    known = as_measured.valid
    others: list[tuple[str, float, float]] = []
    for axis, slopes, places in (("x", as_measured.design_slope_x, x), ("y", as_measured.design_slope_y, y)):
        value, sigma = (_number(numbers, f"{kind}curvature_{axis}_per_m") for kind in ("", "sigma_"))
        own = float(np.polyfit(places[known], slopes[known], 1)[0])
        if abs(value - own) > max(_OTHER_DESIGN * abs(own), _SURE * sigma) and own != 0:
            others.append((axis, value, own))
    if not others:
        yield from off_design(numbers, to_check)
        return
    measured = ", ".join(f"{0.5 / value:.4g} m in {axis}" for axis, value, _ in others)
    design = ", ".join(f"{0.5 / own:.4g} m" for _, _, own in others)
    _, value, own = max(others, key=lambda one: abs(one[1] - one[2]))
    yield Doubt(
        "scan_contradicts_design",
        f"the slopes have a focal length of {measured}, the design ({as_measured.design}) {design}: is that the design "
        f"of this mirror, and x across? Check {to_check}",
        {"measured_per_m": value, "design_per_m": own},
        Severity.SERIOUS,
    )


def doubts_of_amount(numbers: Mapping[str, float | int | None], repeated: int, what: str) -> Iterator[Doubt]:
    """Yield that little was measured, and that rows of the table say what others say.

    numbers: Headline numbers of the mirror. repeated: How many do. what: What a row is.
    """
    share = _number(numbers, "measured_share")
    if share < LEAST_SHARE:
        yield Doubt(
            "little_measured",
            f"{100 * share:.3g} % of what was scanned has slopes: every number is that of a small part",
            {"measured_share": share},
            Severity.SERIOUS,
        )
    if repeated:
        yield Doubt(
            "rows_repeated",
            f"{repeated} rows of the table say again what another says: each {what} counts once; was a file read "
            "twice?",
            {"repeated_count": repeated},
            Severity.NOTE,
        )


def _number(numbers: Mapping[str, float | int | None], name: str) -> float:
    value = numbers.get(name)
    return float("nan") if value is None else float(value)
