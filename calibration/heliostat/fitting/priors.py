"""What is known of a heliostat before anything is measured: sigmas of its numbers, with where each comes from."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from calibration.heliostat.kinematic_model.design import HeliostatDesign, LinearActuator
from calibration.heliostat.kinematic_model.presets import with_drive_terms


@dataclass(frozen=True, slots=True)
class PriorSigma:
    """What a number may be wrong by before anything is measured.

    sigma: Standard deviation in the parameter's unit; a share of its value if relative.
    source: Where that comes from.
    relative: Whether sigma is a share of the value.
    """

    sigma: float
    source: str
    relative: bool = False

    def of(self, value: float) -> float:
        """Return the standard deviation of a number of this value."""
        return self.sigma * abs(value) if self.relative else self.sigma


_POST = PriorSigma(5e-3, "posts are plumbed: EN 1090-2 allows a three-hundredth of the height")
_HEADING = PriorSigma(0.1, "a post is turned to a compass or a plumb line's shadow: some degrees")
_SWITCH = PriorSigma(0.01, "zero by a limit switch or an inclinometer: half a degree")
_AXES = PriorSigma(2e-3, "welded and turned frames keep axes square to a tenth of a degree")
_PLACE = PriorSigma(0.1, "satellite survey of posts in the field")
_HEIGHT = PriorSigma(2.0, "which point of the post was surveyed, and above which zero, is seldom recorded")
_PART = PriorSigma(3e-4, "general tolerance ISO 2768-m of parts from 120 to 400 mm: 0.5 mm at most")
_WEIGHT = PriorSigma(3e-3, "frames of some square metres bend by a few milliradians under their weight")
_PITCH = PriorSigma(7e-4, "rolled ball screws, ISO 3408-3 grade T10: 0.21 mm in 300 mm", relative=True)
_ARM = PriorSigma(0.01, "mirror glued and screwed to its arm: a centimetre")
_WORM = PriorSigma(2e-3, "data sheets of slew drives state a tracking precision of 0.1 degree")
_PLAY = PriorSigma(4e-3, "data sheets of slew drives state a backlash of 0.1 to 0.2 degree")
_RATIO = PriorSigma(1e-3, "teeth are counted; what is left of a ratio is rounded numbers and the encoder's scale")

#: Prior sigmas by the names that the presets give.
PRIORS: Mapping[str, PriorSigma] = {
    **dict.fromkeys(("tilt_north", "tilt_east", "tilt_about_east", "tilt_about_north", "tilt_1_n"), _POST),
    **dict.fromkeys(("tilt_1_u", "azimuth_offset"), _HEADING),
    **dict.fromkeys(("tilt_2_e", "elevation_offset", "initial_angle_2"), _SWITCH),
    **dict.fromkeys(("tilt_2_n", "non_orthogonality", "canting"), _AXES),
    **dict.fromkeys(("position_e", "position_n"), _PLACE),
    "position_u": _HEIGHT,
    **dict.fromkeys(("sag_1", "sag_2"), _WEIGHT),
    **dict.fromkeys(
        (f"{part}_{axis}" for part in ("initial_stroke", "offset", "pivot_radius") for axis in (1, 2)), _PART
    ),
    **dict.fromkeys(("increment_1", "increment_2"), _PITCH),
    **dict.fromkeys(("arm_normal", "arm_up"), _ARM),
    **dict.fromkeys((f"worm_{part}_{axis}" for part in ("sin", "cos", "sin2", "cos2") for axis in (1, 2)), _WORM),
    **dict.fromkeys(("backlash_1", "backlash_2"), _PLAY),
    **dict.fromkeys(("scale_1", "scale_2"), _RATIO),
}

#: Errors of the drives that a heliostat has only where they are asked for: then they are free.
ASKED_FOR = tuple(name for name, prior in PRIORS.items() if prior in (_WORM, _PLAY, _RATIO))

#: Parts of the drives: free only where the observations prove that they must be.
PARTS = ("initial_angle_2", *(name for name, prior in PRIORS.items() if prior in (_PART, _ARM, _PITCH)))


def with_priors(design: HeliostatDesign, names: tuple[str, ...] | None = None) -> HeliostatDesign:
    """Return the same heliostat with what is known before as the sigmas of its parameters.

    names: Only these parameters become free within their priors, all others are held; all that have one but the
        parts of the drives (`PARTS`) if not given.
    Returns: With `PRIORS` as sigmas; a finite sigma of its own (a survey's) takes their place. A heliostat with
        linear actuators gets the bending of its first axis.
    InputError: A name that the design does not have.
    """
    design = with_bending(design)
    known = tuple(name for name in PRIORS if name in design.parameters.names and name not in PARTS)
    chosen = known if names is None else names
    sigmas = {name: prior_sigma(design, name) for name in chosen}
    return design.with_parameters(design.parameters.with_only_free(()).with_sigmas(sigmas))


def prior_sigma(design: HeliostatDesign, name: str) -> float:
    """Return the design's own prior sigma of a parameter, or the usual one; inf where nothing is known."""
    own = design.parameters.sigma(name)
    if 0 < own < float("inf") or name not in PRIORS:
        return own
    return PRIORS[name].of(design.parameters.value(name))


def with_bending(design: HeliostatDesign) -> HeliostatDesign:
    """Return the same heliostat with bending by weight about its elevation axis as one more (held) parameter.

    Returns: With ``sag_1`` if its first drive is a linear actuator that bends nothing yet; otherwise as it was.
    """
    return _bending(design, 0)


def with_all_terms(design: HeliostatDesign) -> HeliostatDesign:
    """Return the same heliostat with bending about both axes as further (held) parameters.

    Returns: With ``sag_1`` and ``sag_2`` for linear actuators that bend nothing yet; otherwise as it was.
    """
    return _bending(_bending(design, 0), 1)


def _bending(design: HeliostatDesign, drive: int) -> HeliostatDesign:
    own = design.drives[drive]
    if not isinstance(own, LinearActuator) or own.terms.names or f"sag_{drive + 1}" in design.parameters.names:
        return design
    # The mirror stands upright where the first axis is at 0: there its weight has the longest lever.
    return with_drive_terms(design, drive, ("sag",), sag_zero_rad=0.0)


def with_terms_free(design: HeliostatDesign, names: Collection[str]) -> HeliostatDesign:
    """Return the same heliostat with errors of its drives free within their priors.

    names: Those that were asked for; of these what is free already keeps its sigma, and what the design does not
        have is passed over.
    """
    parameters = design.parameters
    held = [name for name in names if name in parameters.names and parameters.sigma(name) == 0]
    return design.with_parameters(
        parameters.with_sigmas({name: PRIORS[name].of(parameters.value(name)) for name in held})
    )
