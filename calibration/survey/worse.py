"""Of which quantities of a store worse has a meaning, and which of them people look at first."""

#: Parts of names of which a smaller value is worse.
_GOOD = ("reflect", "intercept", "answered", "solar_weighted", "reading", "measured_share", "collected")
#: Parts of names of what is lost, or could be gained: the larger the worse, whatever else the name says.
_LOST = ("_lost", "_loss", "intercept_gain")
#: Words of names of errors: the larger, whatever the sign, the worse.
_ERRORS = frozenset({"sd", "sdx", "sdy", "rms", "canting", "d50", "d90", "d95", "width", "scatter", "residual"}) | {
    *("error", "errors", "deviation", "beam", "pointing", "theta", "backlash", "play")
}
#: What people look at first, by parts of names, in this order.
_FIRST = ("sd_rad", "canting", "beam_rms", "intercept", "reflect", "d90", "rms", "sd_best")


def worse(quantity: str) -> str:
    """Return whether "larger" or "smaller" values are worse; empty: neither, as of a focal length.

    >>> worse("sd_rad"), worse("reflectance_share"), worse("curvature_x_per_m")
    ('larger', 'smaller', '')
    """
    if any(part in quantity for part in _LOST):
        return "larger"
    if any(part in quantity for part in _GOOD):
        return "smaller"
    return "larger" if _ERRORS.intersection(quantity.split("_")) else ""


def extreme(quantity: str) -> str:
    """Return what the first subjects of a quantity are called.

    >>> extreme("sd_rad"), extreme("curvature_x_per_m")
    ('worst', 'largest')
    """
    return "worst" if worse(quantity) else "largest"


def rank(quantity: str) -> int:
    """Return where a quantity stands: what people look at first, then what can be worse, then the rest."""
    if not worse(quantity):
        return len(_FIRST) + 1
    return next((place for place, part in enumerate(_FIRST) if part in quantity), len(_FIRST))


def headlines(quantities: list[str], most: int) -> list[str]:
    """Return the quantities that stand on a first screen: of which worse has a meaning; of none such, all.

    quantities: In their order.
    most: No more than these.
    """
    return ([one for one in quantities if worse(one)] or quantities)[:most]
