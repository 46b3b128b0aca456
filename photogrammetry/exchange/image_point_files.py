"""Image points measured by another program: ``image_points.csv``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.results.tables import read_columns_csv, write_table_csv
from heliogauge.validate import BoolArray, FloatArray
from photogrammetry.image_points import ImagePoints

COLUMNS = ("image", "target", "x_px", "y_px")
SIGMA_COLUMNS = ("sigma_x_px", "sigma_y_px")

SizesOf = Callable[[Sequence[str]], Mapping[str, tuple[int, int]]]


class PixelOrigin(StrEnum):
    """Where the program counted pixels from."""

    CENTER = "center"
    CORNER = "corner"


@dataclass(frozen=True, slots=True, eq=False)
class ImagePointFile:
    """What an ``image_points.csv`` held.

    points: The image points; the centre of the top-left pixel is (0, 0).
    sigma_assumed: Whether sigmas were missing and one for all was taken: then only their ratios are known, and the
        adjustment should scale its covariance a posteriori.
    doubts: What is doubtful, to repeat in the report.
    """

    points: ImagePoints
    sigma_assumed: bool
    doubts: tuple[Doubt, ...]


def read_image_points_csv(
    path: Path,
    *,
    origin: PixelOrigin = PixelOrigin.CENTER,
    default_sigma_px: float = 0.1,
    sizes_px: SizesOf | Mapping[str, tuple[int, int]] | tuple[int, int] | None = None,
) -> ImagePointFile:
    """Read ``image_points.csv``.

    path: The file, with the columns image, target, x_px, y_px and, optionally, sigma_x_px, sigma_y_px.
    origin: Whether (0, 0) is the centre or the outer corner of the top-left pixel (PhotoModeler, DBAT, COLMAP:
        corner).
    default_sigma_px: Sigma of image points that have none, where no other has one either; else the median of the
        others [px].
    sizes_px: Width and height of each image or of all, or what gives those of each from their names, to see whether
        points lie inside [px].
    InputError: A missing column, cells that are no numbers, a sigma that is not positive, a target twice in one
        image (named with both lines), image points outside their image (with a hint when x and y look swapped).
    """
    texts, values = read_columns_csv(path, COLUMNS[:2], COLUMNS[2:], optional=SIGMA_COLUMNS)
    photos, targets = texts["image"], texts["target"]
    if not photos:
        raise InputError(f"{path}: there are no image points in it")
    _check_names(path, photos, targets)
    pixels = np.column_stack([values[name] for name in COLUMNS[2:]])
    if not np.isfinite(pixels).all():
        line = int(np.argmax(~np.isfinite(pixels).all(axis=1))) + 2
        raise InputError(f"{path}, line {line}: x_px and y_px must be numbers")
    doubts: tuple[Doubt, ...] = ()
    sigmas, missing = _sigmas(path, values, default_sigma_px)
    if missing.any():
        text = (
            f"{path.name}: {int(missing.sum())} of {len(photos)} image points have no sigma; "
            f"{sigmas[np.argmax(missing), 0]:g} px was taken. Only ratios of the sigmas are known then, so the "
            'residuals scale the covariance unless measurement.toml has [adjustment] sigmas = "stated"'
        )
        numbers = {"missing_count": int(missing.sum()), "image_points_count": len(photos)}
        doubts = (Doubt("image_points_without_sigma", text, numbers),)
    if origin is PixelOrigin.CORNER:
        pixels = pixels - 0.5
    if sizes_px is not None:
        known = sizes_px(list(dict.fromkeys(photos))) if callable(sizes_px) else sizes_px
        _check_inside(path, photos, pixels, known)
    covariance = np.zeros((len(photos), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = sigmas.T**2
    return ImagePointFile(ImagePoints.from_names(photos, targets, pixels, covariance), bool(missing.any()), doubts)


def write_image_points_csv(path: Path, points: ImagePoints) -> None:
    """Write ``image_points.csv``; the centre of the top-left pixel is (0, 0). Correlations of x and y are not kept."""
    sigmas = np.sqrt(np.einsum("mii->mi", points.covariance_px2))
    write_table_csv(
        path,
        {
            "image": [points.photos[i] for i in points.photo_index.tolist()],
            "target": [points.targets[i] for i in points.target_index.tolist()],
            "x_px": points.pixels_px[:, 0].tolist(),
            "y_px": points.pixels_px[:, 1].tolist(),
            "sigma_x_px": sigmas[:, 0].tolist(),
            "sigma_y_px": sigmas[:, 1].tolist(),
        },
    )


def _check_names(path: Path, photos: list[str], targets: list[str]) -> None:
    if all(photos) and all(targets) and len(set(zip(photos, targets, strict=True))) == len(photos):
        return
    first: dict[tuple[str, str], int] = {}
    for line, pair in enumerate(zip(photos, targets, strict=True), start=2):
        if not all(pair):
            raise InputError(f"{path}, line {line}: image and target need a name")
        if pair in first:
            raise InputError(
                f"{path}, lines {first[pair]} and {line}: target {pair[1]} is measured twice in image {pair[0]}; "
                "keep one (two sheets with the same codes?)"
            )
        first[pair] = line


def _sigmas(path: Path, values: Mapping[str, FloatArray], default_px: float) -> tuple[FloatArray, BoolArray]:
    none = np.full(len(values["x_px"]), np.nan)
    sigmas = np.column_stack([values.get(name, none) for name in SIGMA_COLUMNS])
    # One sigma serves both axes.
    sigmas = np.where(np.isnan(sigmas), sigmas[:, ::-1], sigmas)
    bad = (sigmas <= 0).any(axis=1) | np.isinf(sigmas).any(axis=1)
    if bad.any():
        line = int(np.argmax(bad)) + 2
        raise InputError(
            f"{path}, line {line}: sigma_x_px and sigma_y_px must be positive; leave the cell empty if unknown"
        )
    missing = np.isnan(sigmas).any(axis=1)
    known = sigmas[~missing]
    typical = float(np.median(known)) if known.size else default_px
    sigmas[missing] = typical
    return sigmas, np.asarray(missing)


def _check_inside(
    path: Path,
    photos: list[str],
    pixels: FloatArray,
    sizes_px: Mapping[str, tuple[int, int]] | tuple[int, int],
) -> None:
    if isinstance(sizes_px, Mapping):
        unknown = sorted({name for name in photos if name not in sizes_px})
        if unknown:
            raise InputError(f"{path}: the size of the images {', '.join(unknown[:5])} is not known")
        sizes = np.array([sizes_px[name] for name in photos], dtype=np.float64)
    else:
        sizes = np.broadcast_to(np.array(sizes_px, dtype=np.float64), pixels.shape)
    # A centre may lie a little outside where a target is cut by the border.
    outside = ~_within(pixels, sizes)
    if not outside.any():
        return
    swapped = _within(pixels[:, ::-1], sizes)
    hint = "; with x_px and y_px exchanged all are inside: are the columns swapped?" if swapped.all() else ""
    line = int(np.argmax(outside)) + 2
    x, y = pixels[line - 2]
    width, height = sizes[line - 2]
    raise InputError(
        f"{path}, line {line}: ({x:.1f}, {y:.1f}) is outside the image of {width:.0f} x {height:.0f} px, as are "
        f"{int(outside.sum()) - 1} others of {len(photos)}{hint}"
    )


def _within(pixels: FloatArray, sizes: FloatArray) -> BoolArray:
    return np.asarray(((pixels >= -0.5) & (pixels <= sizes - 0.5)).all(axis=1))
