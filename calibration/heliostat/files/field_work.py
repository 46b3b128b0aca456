"""What the page of a field says of one heliostat: whether it needs work, in a plain sentence, and dates of bad rows."""

from collections.abc import Sequence

import numpy as np

from calibration.heliostat.diagnosis.findings import Finding
from calibration.heliostat.files.result import HeliostatResult
from heliogauge.sunlight.sun_shapes import SOLAR_DISC_RAD

#: Held-out beams that miss by more than twice of what was expected, and not by chance: rows that one fit predicts miss
#: together, so that of ten thousand sound heliostats some two hundred come out above twice, ten below this chance.
_FAR_OVER_EXPECTED, _NO_CHANCE = 2.0, 1e-3
#: Severities of findings that ask for work on the heliostat or its records, and of single rows.
_WORK, _ROWS = ("fault", "doubt"), "rows"
_MOST_DATES = 3


def found_over_expected(result: HeliostatResult) -> float | None:
    """Return the RMS of held-out beams over what was expected of them; None where none were held out."""
    if result.main is None:
        return None
    prediction = result.main.prediction
    # What is found holds the measurement's own errors too: as stated, or where the residuals show less, that.
    share = min([1.0, *result.main.fit.sigma_factors.values()])
    sigma = np.hypot(prediction.sigma_beam_rad, share * prediction.sigma_noise_rad)
    known = sigma[np.isfinite(sigma)]
    expected = float(np.sqrt(np.mean(known**2))) if known.size else 0.0
    found = result.main.test.beam_rms_rad
    return found / expected if expected > 0 and np.isfinite(found) else None


def work_of(result: HeliostatResult) -> str:
    """Return what is to be done about a heliostat in a plain sentence; empty where nothing is."""
    asked = work_of_findings(result.diagnosis.findings)
    if asked:
        return asked
    ratio = found_over_expected(result)
    far = ratio is not None and ratio > _FAR_OVER_EXPECTED
    if far and (misses := result.misses(result.split)) is not None and misses.chance < _NO_CHANCE:
        return (
            f"Held-out beams miss by {ratio:.1f} times of what was expected: something changes that the model does not "
            "have. Look at the residuals against time and sun."
        )
    if result.sky is not None and result.sky.rms_beam_rad > SOLAR_DISC_RAD:
        return (
            f"Its beam is expected to be wrong by {1e3 * result.sky.rms_beam_rad:.1f} mrad over the sky, more than the "
            "radius of the sun. Measure more: heliogauge heliostat plan says at which suns."
        )
    return ""


def work_of_findings(findings: Sequence[Finding]) -> str:
    """Return what findings ask for, the gravest two; empty where they ask for nothing."""
    return " ".join(_sentence(one) for one in [one for one in findings if one.severity in _WORK][:2])


def _sentence(finding: Finding) -> str:
    dates = dates_text(finding.dates)
    return f"{finding.kind.replace('_', ' ').capitalize()}{f' ({dates})' if dates else ''}: {finding.remedy}"


def bad_row_dates(result: HeliostatResult) -> tuple[str, ...]:
    """Return the dates of rows that something is wrong with, in order, each once."""
    findings = [one for one in result.diagnosis.findings if one.severity in (*_WORK, _ROWS)]
    return tuple(sorted({date[:10] for one in findings for date in one.dates if date}))


def dates_text(dates: Sequence[str]) -> str:
    """Return dates in words: the first ones, and how many more there are.

    >>> dates_text(["2023-08-15", "2023-08-16", "2023-09-01", "2023-09-02", "2023-09-03"])
    '2023-08-15, 2023-08-16, 2023-09-01 and 2 more days'
    """
    days = sorted({date[:10] for date in dates if date})
    more = len(days) - _MOST_DATES
    text = ", ".join(days[:_MOST_DATES])
    return text if more <= 0 else f"{text} and {more} more day{'s' if more > 1 else ''}"
