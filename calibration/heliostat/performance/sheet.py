"""The data sheet of a heliostat: its lines, what every sheet has, and the rule of decision."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from calibration.heliostat.performance.entries import Conformity, Decision, Entry, Limit
from heliogauge.doubts import Doubt

#: What every sheet has, measured or not (Stage-STE 12.6, 1.4 and 1.4.1).
STANDARD: tuple[tuple[str, str, str], ...] = (
    ("day", "beam_rms_rad", "Tracking accuracy, RMS of the beam's error"),
    ("day", "normal_rms_rad", "Tracking accuracy, RMS of the normal's error"),
    ("day", "beam_spread_rad", "Tracking precision, beam about its mean"),
    ("day", "beam_noon_right_rad", "Beam at solar noon, to the right"),
    ("day", "beam_noon_up_rad", "Beam at solar noon, up"),
    ("drift", "right_beam_rad", "Drift of the beam to the right, range of the cubic"),
    ("drift", "up_beam_rad", "Drift of the beam upwards, range of the cubic"),
    ("repeat", "right_beam_rad", "Repeatability of the beam to the right, standard deviation"),
    ("repeat", "up_beam_rad", "Repeatability of the beam upwards, standard deviation"),
    ("backlash", "azimuth_axis_rad", "Backlash of the azimuth axis, end to end"),
    ("backlash", "elevation_axis_rad", "Backlash of the elevation axis, end to end"),
    ("wind", "w1_1_beam_rms_rad", "Beam accuracy in wind class W1.1 (full operation), RMS"),
    ("wind", "w1_2_beam_rms_rad", "Beam accuracy in wind class W1.2 (reduced accuracy), RMS"),
    ("quality", "sd_rad", "Normal's slope deviation SD from the design, RMS"),
    ("quality", "sd_best_focus_rad", "Normal's slope deviation SD from the best-fit focal length, tilt removed, RMS"),
    ("quality", "canting_rms_rad", "Canting error of the facets' normals, RMS"),
    ("quality", "beam_d90_m", "Diameter of the beam that holds 90 % of its light, median"),
    ("sun_camera", "normal_rms_rad", "Shift of the normal since the start while following the sun, RMS"),
    ("reflectance", "solar_weighted_share", "Solar-weighted reflectance"),
    ("control", "commands_answered_share", "Commands answered in time (test 1)"),
    ("control", "faults_answered_share", "Faults answered in time (test 2)"),
    ("power", "mean_w", "Mean power"),
    ("year", "intercept_share", "Intercept over the year"),
)


@dataclass(frozen=True, slots=True)
class SheetLine:
    """An entry with its limit and what that makes of it."""

    entry: Entry
    limit: Limit | None
    decision: Decision


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """The data sheet of one heliostat.

    lines: Its entries, also those that were not measured.
    about: What is said of heliostat, laboratory and place.
    tables: Rows that pictures are made of, by name.
    doubted: Names of the folders of results with doubts, and how many each has.
    """

    name: str
    lines: tuple[SheetLine, ...]
    about: Mapping[str, str]
    doubts: tuple[Doubt, ...]
    tables: Mapping[str, dict[str, list[str]]] = field(default_factory=dict)
    doubted: Mapping[str, int] = field(default_factory=dict)

    def count(self, conformity: Conformity) -> int:
        """Return how many lines have a conformity."""
        return sum(one.decision.conformity is conformity for one in self.lines)


def decision_rule(confidence: float) -> str:
    """Return the rule of decision in a sentence."""
    return (
        f"Pass: conformity has a probability of at least {100 * confidence:g} %, the uncertainty counted; fail: "
        "of at most "
        f"{100 * (1 - confidence):g} %; conditional: between (ISO 14253-1:2017; ILAC-G8:09/2019, 4.2.3, "
        "non-binary with "
        "guard band)"
    )
