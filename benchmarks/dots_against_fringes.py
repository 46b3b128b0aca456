"""The published facet by dots and by fringes: what of their difference one wrong place of the field of dots explains.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/dots_against_fringes.py``.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from _measure import OPENCSP, row, title
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from deflectometry import load_deflectometry
from deflectometry import run as measure_fringes
from deflectometry.comparison import compare_results
from deflectometry.dots import load_dots
from deflectometry.dots import run as measure_dots
from deflectometry.exchange import OpencspOptions, import_opencsp
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import monomials

COMMON = ("spatial_orientation.h5", "Facet_NSTTF.json")
#: Distances over which what is left is compared with itself [m].
LAGS_M = (0.02, 0.1, 0.2)


def measured(scratch: Path):
    """Measure both; the result of the fringes stands in a folder."""
    dots = [OPENCSP / "fixed" / one for one in ("measurement_facet.h5", "fixed_pattern_dot_locations.h5")]
    fringes = [OPENCSP / "fringe" / "measurement_facet.h5", OPENCSP / "common" / "display_distorted_3d.h5"]
    cameras = {"dots": "camera_sofast.h5", "fringes": "camera_sofast_downsampled.h5"}
    results = {}
    for name, files in (("dots", dots), ("fringes", fringes)):
        files = [*files, *(OPENCSP / "common" / one for one in (cameras[name], *COMMON))]
        options = OpencspOptions(focal_length_m=150.0, correct_principal_point=name == "fringes")
        import_opencsp(files, scratch / name, options)
    results["dots"] = measure_dots(load_dots(scratch / "dots"))
    results["fringes"] = measure_fringes(load_deflectometry(scratch / "fringes"))
    for name, result in results.items():
        (scratch / f"{name}_out").mkdir()
        result.write(scratch / f"{name}_out")
    return results


def beside(values: np.ndarray, x: np.ndarray, y: np.ndarray, degree: int) -> np.ndarray:
    """Return both slopes (2, n) beside polynomials."""
    terms = monomials(x / 0.6, y / 0.6, degree).T
    return values - (terms @ np.linalg.lstsq(terms, values.T, rcond=None)[0]).T


def slopes_of(points_m: np.ndarray, camera_m: np.ndarray, source_m: np.ndarray) -> np.ndarray:
    """Return the slopes (2, n) of a mirror whose points (3, n) show source points to a camera."""
    normal = 0.0
    for away in (source_m - points_m, camera_m[:, None] - points_m):
        normal = normal + away / np.linalg.norm(away, axis=0)
    return -normal[:2] / normal[2]


def main() -> None:
    if not OPENCSP.is_dir():
        print(f"no published data in {OPENCSP}")
        return
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        results = measured(scratch)
        compared = compare_results(scratch / "dots_out", scratch / "fringes_out")
    motion = compared.placed.motion
    evaluation, setup = results["dots"].evaluation, results["dots"].setup
    ((facet, image),) = evaluation.images.items()
    (surface,) = evaluation.solution.surfaces
    row_at, column_at = np.nonzero(np.isfinite(image.slope_x))
    x, y = image.x_m[row_at, column_at], image.y_m[row_at, column_at]
    u, v = (
        one[row_at + image.row, column_at + image.column] for one in (evaluation.screen_map.u, evaluation.screen_map.v)
    )
    # The fringes at the dots, in the dots' frame: nothing is laid on another grid than where a dot was measured.
    there = motion.b_from_a(x, y)
    fringes = results["fringes"].evaluation.maps.popitem()[1]
    slopes = motion.rotation @ np.stack(
        [
            RegularGridInterpolator((fringes.y_m, fringes.x_m), one, bounds_error=False)(np.stack(there[::-1], axis=1))
            for one in (fringes.slope_x, fringes.slope_y)
        ]
    )
    both = np.isfinite(slopes).all(axis=0)
    x, y, slopes = x[both], y[both], slopes[:, both]
    points = np.stack([x, y, surface.height(x, y)])
    dots_m = setup.screen.points_m(u[both].astype(float), v[both].astype(float))
    middle = dots_m.mean(axis=0)
    (located,) = (one for one in evaluation.located.facets if one.name == facet)
    facet_from_cam = (evaluation.solution.cam_from_mirror @ located.ensemble_from_facet).inverse()
    facet_from_field = facet_from_cam @ setup.cam_from_screen

    def difference(step: np.ndarray) -> np.ndarray:
        turn = RigidTransform.from_rotation_vector(step[:3], np.zeros(3))
        moved = facet_from_field.apply(turn.apply(dots_m - middle) + middle + step[3:])
        return slopes_of(points, facet_from_cam.translation_m, moved.T) - slopes

    def misfit(step: np.ndarray) -> np.ndarray:
        left = 1e3 * difference(step)
        return (left - left.mean(axis=1, keepdims=True)).ravel()

    found = least_squares(misfit, np.zeros(6), x_scale=[0.01] * 3 + [0.05] * 3)
    cases = {"as published": difference(np.zeros(6)), "field moved as one": difference(found.x)}
    title(f"The published facet, dots minus fringes, at {both.sum()} dots: RMS x / y [mrad]", tuple(cases))
    names = ("mean", "linear terms", "quadratics", "cubics")
    for degree, text in enumerate(names):
        left = [1e3 * np.sqrt(np.mean(beside(one, x, y, degree) ** 2, axis=1)) for one in cases.values()]
        row(f"beside {text}", *(f"{one[0]:.3f} / {one[1]:.3f}" for one in left))
    row("the field turns by [mrad]", "", " ".join(f"{1e3 * one:.0f}" for one in found.x[:3]))
    row("and moves by [m]", "", " ".join(f"{one:.2f}" for one in found.x[3:]))
    rest = beside(cases["field moved as one"], x, y, 3)
    tree = cKDTree(points[:2].T)
    for lag in LAGS_M:
        away, other = tree.query(points[:2].T + [lag, 0.0])
        near = away < 0.006
        alike = np.mean(rest[:, near] * rest[:, other[near]], axis=1) / np.mean(rest**2, axis=1)
        row(f"correlation of what is beside cubics over {lag:g} m", "", f"{alike[0]:.2f} / {alike[1]:.2f}")
    row(
        "noise of a dot, of a node of the fringes [mrad]",
        "",
        " / ".join(f"{1e3 * np.nanmedian(one):.3f}" for one in (image.sigma_x, fringes.sigma_random_x)),
    )


if __name__ == "__main__":
    main()
