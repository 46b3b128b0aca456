"""What two halves of a flight say of each other, in words."""

from collections.abc import Iterator, Mapping

import numpy as np

from heliogauge.adjust.chi_square import chi_square_limit
from heliogauge.doubts import Doubt
from observer.doubts.by_chance import chance
from observer.slopes.halves import Halves

#: An effect on the slopes of less than this share of their sigma is not worth a doubt: it adds an eighth to it.
_WORTH_SIGMAS = 0.5


def halves_limit(count: int, n_modules: int = 1) -> float:
    """Return up to which chi-square, for each difference, chance makes halves different: of many modules in none.

    count: Differences.
    n_modules: Modules that are judged alike.
    """
    return chi_square_limit(chance(n_modules), count) / count


def halves_text(rms_rad: float, expected_rad: float, chi_square: float, limit: float) -> str:
    """Say whether the halves agree.

    rms_rad, expected_rad: RMS of what they differ by, and what is expected of it [rad].
    chi_square, limit: Of their differences, for each of them, and the largest one of chance.

    Where few modes of the covariance are large, the RMS may be as expected and the others contradict each other.
    """
    agree = chi_square <= limit
    verdict = "agree: means and bends of panels differ by" if agree else "differ by more than chance: panels by"
    ratio = (
        f"; by the whole covariance of that, poses or places of edges err {np.sqrt(chi_square):.1f} times as much as "
        "their sigmas say"
    )
    return (
        f"two halves of the flight (every second photo) {verdict} {1e3 * rms_rad:.2g} mrad RMS where "
        f"{1e3 * expected_rad:.2g} is expected{'' if agree else ratio}"
    )


def halves_words(numbers: Mapping[str, float | int | None]) -> Iterator[str]:
    """Yield what a result says of its halves, if anything.

    numbers: Of its summary.
    """
    names = ("difference_rms_rad", "expected_rms_rad", "chi_square_ratio", "chi_square_limit_ratio")
    rms, expected, chi_square, limit = (float(numbers.get(f"halves_{name}") or 0.0) for name in names)
    if limit:
        yield f"{halves_text(rms, expected, chi_square, limit)}; what all photos share is not tested by that"


def halves_doubt(found: Halves | None, usual_sigma_rad: float, n_modules: int = 1) -> Doubt | None:
    """Say that the halves differ by more than chance, where that matters beside the sigma of the slopes.

    usual_sigma_rad: Usual sigma of a slope [rad].

    The map is the mean of both halves and errs by half of what they differ. Birge's ratio, the root of chi-square over
    its expectation, is what sigmas of what differs from photo to photo have to be multiplied by.
    """
    if found is None:
        return None
    chi_square, limit = found.chi_square, halves_limit(found.difference_rad.size, n_modules)
    if chi_square <= limit:
        return None
    unexplained = 0.5 * found.expected_rad * float(np.sqrt(max(chi_square - 1, 0.0)))
    if unexplained < _WORTH_SIGMAS * usual_sigma_rad:
        return None
    larger = float(np.hypot(usual_sigma_rad, unexplained))
    return Doubt(
        "halves_of_flight_differ",
        f"{halves_text(found.rms_rad, found.expected_rad, chi_square, limit)}. For the sigma of a slope take "
        f"{1e3 * larger:.2g} in place of {1e3 * usual_sigma_rad:.2g} mrad. Did the camera move while it "
        "exposed, zoom or refocus, or the collector turn?",
        {
            "difference_rms_rad": found.rms_rad,
            "expected_rms_rad": found.expected_rad,
            "chi_square_ratio": chi_square,
            "sigma_slope_rad": larger,
        },
    )
