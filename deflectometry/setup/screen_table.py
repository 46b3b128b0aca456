"""Whether a table of measured screen points can be trusted: its units, single wrong points, what it covers."""

import numpy as np

from deflectometry.setup.camera_and_screen import Screen, TabulatedScreen
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.slopes.map import monomials
from heliogauge.validate import AnyFloatArray, FloatArray

#: Display coordinates are fractions; measured points may lie a little outside of the displayed image.
_FARTHEST = 0.5
#: A point this many times farther from the smooth wall than the usual one, and by this length, is a mistake.
_OUTLIER_SIGMAS = 15.0
_OUTLIER_M = 5e-3
#: Share of pixels that see beyond the table from which it is a doubt.
_BEYOND_SHARE = 0.01


def refuse_other_units(columns: FloatArray, name: str) -> None:
    """Refuse a table in other units.

    columns (5, n): u, v, x, y, z of each point.
    name: The file, for messages.
    InputError: Display coordinates that are no fractions.
    """
    display = columns[:2]
    if display.size and (display.min() < -_FARTHEST or display.max() > 1 + _FARTHEST):
        raise InputError(
            f"{name}: u, v go from {display.min():g} to {display.max():g}; fractions of the displayed image are needed "
            "(0 to 1, u from its left edge, v from its top edge)"
        )


def check_screen_points(screen: TabulatedScreen, name: str) -> Doubt | None:
    """Return a doubt where measured points are far off the smooth surface through all of them.

    name: The file, for the text.
    """
    terms = monomials(2 * screen.u - 1, 2 * screen.v - 1, 4)
    if screen.u.size < 2 * len(terms):
        return None
    weight = np.ones(screen.u.size)
    for _ in range(4):
        fitted = np.linalg.lstsq((terms * weight).T, screen.xyz_m * weight[:, None], rcond=None)[0]
        away = np.linalg.norm(screen.xyz_m.T - fitted.T @ terms, axis=0)
        # A single point that is half a metre off must not bend the surface by which it is judged.
        weight = 1.0 / np.maximum(away, max(float(np.median(away)), 1e-9))
    wrong = np.flatnonzero((away > _OUTLIER_SIGMAS * np.median(away)) & (away > _OUTLIER_M))
    if not wrong.size:
        return None
    worst = int(wrong[np.argmax(away[wrong])])
    return Doubt(
        "screen_points_stand_out",
        f"{name}: {wrong.size} of {away.size} points stand out of the smooth surface of all, the worst in line "
        f"{worst + 2} (u = {screen.u[worst]:g}, v = {screen.v[worst]:g}) by {1e3 * away[worst]:.3g} mm",
        {"points_count": wrong.size, "line_number": worst + 2, "largest_departure_m": float(away[worst])},
    )


def check_beyond_table(screen: Screen, seen_u: AnyFloatArray, seen_v: AnyFloatArray) -> Doubt | None:
    """Return a doubt where the mirror shows parts of the display that no measured point surrounds.

    seen_u, seen_v (n,): Display coordinates that good pixels see.
    """
    if not isinstance(screen, TabulatedScreen):
        return None
    beyond = np.zeros(seen_u.size, dtype=np.bool_)
    reach = []
    for name, seen, table in (("u", seen_u, screen.u), ("v", seen_v, screen.v)):
        low, high = float(table.min()), float(table.max())
        # Half the usual distance between points: so far the surface beside them is as good as between them.
        margin = 0.5 * (high - low) / max(np.sqrt(table.size) - 1.0, 1.0)
        beyond |= (seen < low - margin) | (seen > high + margin)
        reach.append(f"{name} from {low:.3g} to {high:.3g}")
    share = float(beyond.mean()) if beyond.size else 0.0
    if share <= _BEYOND_SHARE:
        return None
    return Doubt(
        "screen_seen_beyond_table",
        f"screen table: {share:.0%} of the pixels see beyond the measured points ({', '.join(reach)}); there the "
        "screen is a guess: measure points up to the edges of the displayed image",
        {"beyond_share": share},
    )
