"""Camera and screen as stated and as found, and the poses that found them."""

import math

from heliogauge.reporting.html import Html, table
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.results import Results
from heliogauge.results.folder import read_table_csv

#: Below this share of its stated variance taken away a parameter counts as not determined, as in the summary.
_LEAST_SHARE = 0.19


def setup_table(results: Results) -> Html:
    """Return the parameters of camera and screen: stated, found, how far they moved, what the poses determine."""
    columns = read_table_csv(results.folder / "setup.csv")
    rows = []
    for index, name in enumerate(columns["parameter"]):
        stated, sigma_stated, found, sigma_found, moved, share = (
            float(columns[key][index])
            for key in ("stated", "sigma_stated", "found", "sigma_found", "moved_in_stated_sigmas", "determined_share")
        )
        unit = columns["unit"][index]
        rows.append(
            (
                name,
                number_text(stated, sigma_stated, unit),
                number_text(found, sigma_found, unit),
                f"{moved:+.1f}",
                f"{sigma_stated / sigma_found:.1f} times" if share >= _LEAST_SHARE else "not determined: as stated",
            )
        )
    head = ("parameter", "stated", "found", "moved, in stated sigmas", "surer by")
    return table(head, rows, numbers=(1, 2, 3))


def pose_numbers(results: Results) -> Html:
    """Return where the mirror stood in each pose, and the curvatures that it alone gives with the setup as stated."""
    columns = read_table_csv(results.folder / "poses.csv")
    rows = []
    for index, name in enumerate(columns["pose"]):
        of_pose = {key: float(values[index] or "nan") for key, values in columns.items() if key != "pose"}
        curvatures = [
            number_text(of_pose[f"alone_{key}"], of_pose[f"alone_sigma_{key}"], "1/m")
            for key in ("curvature_x_per_m", "curvature_y_per_m")
        ]
        residual = of_pose["residual_px"]
        rows.append(
            (
                name,
                f"{math.degrees(of_pose['roll_rad']):.0f} deg",
                number_text(of_pose["outline_distance_m"], of_pose["sigma_outline_distance_m"], "m"),
                number_text(of_pose["camera_distance_m"], of_pose["sigma_camera_distance_m"], "m"),
                f"{of_pose['screen_distance_m']:.3f} m",
                "-" if math.isnan(residual) else f"{residual:.3f} px",
                *curvatures,
            )
        )
    numbers = results.summary.numbers
    joint = [
        number_text(float(numbers[key] or 0.0), numbers[f"sigma_{key}"], "1/m")
        for key in ("curvature_x_per_m", "curvature_y_per_m")
    ]
    rows.append(("all together", "", "", "", "", "", *joint))
    head = ("pose", "turned", "to camera, stated", "found", "to screen", "outline", "1/(2 f) in x", "in y")
    return table(head, rows, numbers=tuple(range(1, 8)))
