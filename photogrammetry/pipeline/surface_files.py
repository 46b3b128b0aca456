"""What was found of a surface, as files and headline numbers."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from heliogauge.results.folder import ASSEMBLED, write_slope_map, write_table_csv
from heliogauge.slopes.statistics import statistics
from photogrammetry.networks.quality import Numbers
from photogrammetry.pipeline.surface import SurfaceResult
from photogrammetry.surface.displacement import Displacements
from photogrammetry.surface.fitted import SurfaceFit
from photogrammetry.surface.store_mesh import write_mesh_ply, write_points_ply


def write_surface(result: SurfaceResult, folder: Path, attributes: Mapping[str, Any]) -> None:
    """Write ``surface.csv``, ``slope_map.nc``, ``canting.csv``, ``comparison.csv`` and PLY files, as far as there are.

    result: What was found.
    """
    fit = result.fit
    if fit is not None:
        write_table_csv(folder / "surface.csv", _point_columns(fit, result.facet_of))
        if result.ply or result.mesh is not None:
            write_points_ply(folder / "points.ply", fit.points.points_m, fit.deviation_m)
        if result.mesh is not None:
            used = ~fit.outliers
            write_mesh_ply(folder / "mesh.ply", result.mesh, fit.points.points_m[used], fit.deviation_m[used])
    if result.slopes is not None:
        maps = {ASSEMBLED: result.slopes.whole}
        if len(result.slopes.patches) > 1:
            maps |= result.slopes.patches
        write_slope_map(folder / "slope_map.nc", maps, dict(attributes) | _map_words(result))
    if result.cantings:
        write_table_csv(folder / "canting.csv", _canting_columns(result))
    if result.moved is not None:
        write_table_csv(folder / "comparison.csv", _comparison_columns(result.moved))


def _map_words(result: SurfaceResult) -> dict[str, Any]:
    if result.slopes is None:
        return {}
    bend = ", ".join(f"{1e3 * one:.4f}" for one in result.slopes.bending_rad)
    return {
        "estimator": (
            "local quadratics of the deviations of the 12 nearest points, tricube weights; mean distance of points "
            f"{result.slopes.spacing_m:.4f} m; scatter between points {1e6 * result.slopes.scatter_m:.2f} um and what "
            f"quadratics cannot follow ({bend} mrad in x, y) are part of the random sigmas"
        )
    }


def _point_columns(fit: SurfaceFit, facet_of: tuple[str, ...]) -> dict[str, Any]:
    points, sigma = fit.points.points_m, fit.points.sigma_m
    sigma_z = np.sqrt(np.maximum(np.diag(fit.covariance_deviation_z_m2), 0.0))
    reasons = [
        f"{abs(test):.1f} sigma from the surface, roughness included" if out else ""
        for test, out in zip(fit.tests, fit.outliers, strict=True)
    ]
    columns: dict[str, Any] = {"id": list(fit.points.ids)}
    columns |= {f"{axis}_m": points[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"sigma_{axis}_m": sigma[:, k] for k, axis in enumerate("xyz")}
    return columns | {
        "deviation_m": fit.deviation_m,
        "sigma_deviation_m": fit.sigma_deviation_m,
        "deviation_z_m": fit.deviation_z_m,
        "sigma_deviation_z_m": sigma_z,
        "test": fit.tests,
        "used": (~fit.outliers).astype(int),
        "reason": reasons,
        "facet": list(facet_of) or [""] * len(points),
    }


def _canting_columns(result: SurfaceResult) -> dict[str, Any]:
    found = result.cantings
    sigma = np.array([one.sigma_canting for one in found])
    return {
        "facet": [one.name for one in found],
        "n_points": [one.n_points for one in found],
        "canting_x_rad": [one.canting[0] for one in found],
        "canting_y_rad": [one.canting[1] for one in found],
        "sigma_canting_x_rad": sigma[:, 0],
        "sigma_canting_y_rad": sigma[:, 1],
        "sigma_measurement_x_rad": [one.sigma_canting_measurement[0] for one in found],
        "sigma_measurement_y_rad": [one.sigma_canting_measurement[1] for one in found],
        "piston_m": [one.piston_m for one in found],
        "sigma_piston_m": [one.sigma_piston_m for one in found],
        "rms_m": [one.rms_m for one in found],
        "length_m": [one.length_m for one in found],
        "sigma_length_m": [one.sigma_length_m for one in found],
        "length": [one.length_name.removesuffix("_m") for one in found],
    }


def _comparison_columns(moved: Displacements) -> dict[str, Any]:
    sigma = moved.sigma_m
    columns: dict[str, Any] = {"id": list(moved.ids)}
    columns |= {f"d{axis}_m": moved.displacement_m[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"sigma_d{axis}_m": sigma[:, k] for k, axis in enumerate("xyz")}
    return columns | {
        "length_m": np.linalg.norm(moved.displacement_m, axis=1),
        "probability": moved.probability,
        "moved": moved.moved.astype(int),
        "stable": moved.stable.astype(int),
    }


class SurfaceNumbers(NamedTuple):
    """Headline numbers with units in their names, texts, and why numbers are not determined."""

    numbers: Numbers
    texts: dict[str, str]
    not_determined: dict[str, str]


def surface_numbers(result: SurfaceResult) -> SurfaceNumbers:
    """Return headline numbers, texts, and why numbers are not determined.

    result: What was found.
    """
    numbers: Numbers = {}
    texts: dict[str, str] = {}
    missing: dict[str, str] = {}
    if result.fit is not None:
        _add_fit(result.fit, result.how, numbers, texts)
    if result.slopes is not None:
        found = statistics(result.slopes.whole)
        numbers |= {
            "sdx_rad": found.sdx_rad,
            "sigma_sdx_rad": found.sigma_sdx_rad,
            "sdy_rad": found.sdy_rad,
            "sigma_sdy_rad": found.sigma_sdy_rad,
            "noise_sdx_rad": found.noise_rms_x_rad,
            "noise_sdy_rad": found.noise_rms_y_rad,
            "measured_share": found.measured_share,
        }
        texts |= {"slope map removed": result.slopes.whole.removed, "slope map reference": found.reference}
    if result.cantings:
        turns = np.array([one.canting for one in result.cantings])
        sigmas = np.array([one.sigma_canting for one in result.cantings])
        numbers |= {
            "facets_count": len(turns),
            "canting_rms_x_rad": float(np.sqrt((turns[:, 0] ** 2).mean())),
            "canting_rms_y_rad": float(np.sqrt((turns[:, 1] ** 2).mean())),
            "canting_largest_rad": float(np.linalg.norm(turns, axis=1).max()),
            "canting_sigma_rms_rad": float(np.sqrt((sigmas**2).mean())),
        }
    if result.moved is not None:
        moved = result.moved
        lengths = np.linalg.norm(moved.displacement_m, axis=1)
        numbers |= {
            "compared_count": len(moved.ids),
            "moved_count": int(moved.moved.sum()),
            "displacement_rms_m": float(np.sqrt((lengths**2).mean())),
            "displacement_largest_m": float(lengths.max()),
            "stable_variance_factor": moved.variance_factor,
        }
        texts["compared with"] = f"{result.compared_with}, fitted on {int(moved.stable.sum())} stable targets"
    missing = {key: "no redundancy" for key, one in numbers.items() if one is None or not np.isfinite(one)}
    known = {key: None if key in missing else value for key, value in numbers.items()}
    return SurfaceNumbers(known, texts, missing)


def _add_fit(fit: SurfaceFit, how: str, numbers: Numbers, texts: dict[str, str]) -> None:
    numbers |= {
        "surface_points_count": int((~fit.outliers).sum()),
        "surface_outliers_count": int(fit.outliers.sum()),
        "deviation_rms_m": fit.rms_deviation_m,
        "sigma_deviation_rms_m": fit.sigma_rms_deviation_m,
        "deviation_largest_m": float(np.abs(fit.deviation_m[~fit.outliers]).max()),
        "roughness_m": fit.shape_sigma_m,
        "surface_variance_factor": fit.variance_factor,
    }
    for name, (length, sigma, measured) in fit.parameters.lengths().items():
        numbers |= {
            f"best_fit_{name}": length,
            f"sigma_best_fit_{name}": sigma,
            f"measurement_sigma_best_fit_{name}": measured,
        }
    texts["surface"] = fit.reference.describe()
    texts["surface placed by"] = how + (f"; not felt and held: {'; '.join(fit.held)}" if fit.held else "")
