"""What the images confirm of what measurement.toml states."""

import math

import numpy as np

from deflectometry.pipeline.stated_inputs import INPUTS_FILE, NOT_THE_CAUSE
from heliogauge.reporting.html import Html, table
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.results import Results
from heliogauge.results.folder import read_table_csv

_TEXTS = ("input", "unit")
_NUMBERS = (
    "stated",
    "sigma",
    "sigma_from_images",
    "off_by_images",
    "left_by_images",
    "permille",
    "curvature_x_per_permille_per_m",
    "curvature_y_per_permille_per_m",
)


def stated_table(results: Results) -> Html:
    """Return each stated input beside what the images say of it, and what it does to the focus; nothing without them.

    Directions of the screen's pose have no value of their own: what the images say is how far they are off. Where an
    input off by so much would still leave the images in contradiction, what they say of it alone means nothing.
    """
    path = results.folder / INPUTS_FILE
    if not path.exists():
        return Html("")
    columns = read_table_csv(path, (*_TEXTS, *_NUMBERS))
    rows = []
    for name, unit, *texts in zip(*(columns[one] for one in (*_TEXTS, *_NUMBERS)), strict=True):
        stated, sigma, sigma_images, off, left, permille, by_x, by_y = (
            float(one) if one not in ("", None) else math.nan for one in texts
        )
        has_value = math.isfinite(stated)
        believed = number_text(stated if has_value else 0.0, sigma, unit) if sigma > 0 else "no sigma"
        if has_value and not sigma > 0:
            believed = f"{stated:.7g} {unit}, no sigma"
        seen = "nothing"
        if left > NOT_THE_CAUSE:
            seen = f"not alone: would leave {left:.2g} sigma"
        elif math.isfinite(sigma_images):
            shown = number_text(stated - off if has_value else -off, sigma_images * max(1.0, left), unit)
            seen = shown if has_value else f"off by {shown}"
        by_unit = [f"{2e3 * one / permille:+.2g}" for one in (by_x, by_y)]
        # In one line: a narrow screen scrolls the table.
        words = str(name).removeprefix("the ").replace(" ", "\u00a0")
        rows.append((words, believed, seen, ", ".join(by_unit) + f" 1/km per {unit}"))
    head = ("input", "stated", "according to the images", "changes 1/f in x, y by")
    return table(head, rows, numbers=(1, 2, 3)) if np.size(rows) else Html("")
