"""Results of a calibration on disk: written whole, read whole again for the report."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import numpy as np

from calibration.camera.boards import TargetField
from calibration.camera.files.findings import (
    BoardShape,
    CommonErrors,
    Findings,
    HeldOutPhoto,
    Intrinsic,
    PhotoResult,
    Quality,
)
from calibration.camera.judgement.comparison import compare
from calibration.camera.judgement.network import coverage
from calibration.camera.judgement.projection_sigma import radial_profile, sigma_map
from calibration.camera.start_values.intrinsics import tilt_and_roll
from heliogauge.camera.formats import to_colmap, to_opencv
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.writer import write_text
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    read_camera_json,
    read_cameras_json,
    read_points_csv,
    read_summary,
    read_table_csv,
    write_camera_json,
    write_cameras_json,
    write_points_csv,
    write_table_csv,
)
from heliogauge.results.thumbnails import read_thumbnails, write_thumbnails
from heliogauge.validate import FloatArray

_Form = TypeVar("_Form", bound=Findings)

_IMAGE_NUMBERS = ("x_px", "y_px", "residual_x_px", "residual_y_px", "sigma_x_px", "sigma_y_px", "correlation")
_IMAGE_COLUMNS = ("image", "target", *_IMAGE_NUMBERS, "flag")
_COMPARED = "compared_camera.json"
_LEFT_OUT = "left_out.csv"
_COMMON = "common_errors.csv"
#: Units of effects that are no lengths on the board, with a factor; and the points' own departures.
_COMMON_UNITS = {"low": ("px", 1.0), "high": ("px", 1.0), "focal": ("share", 1.0), "center": ("px", 1.0)}
_POINT_ROWS = ("point x", "point y", "point z")
#: What the lengths of a board are in, where it was drawn in metres or not.
_METRES, _PITCHES = "m", "pitch"


def write_tables(result: Findings, folder: Path) -> None:
    """Write everything but figures and summary.json: cameras, points, tables."""
    poses = {
        photo.name: PhotoPose(result.camera_name, photo.cam_from_board, photo.covariance, photo.rms_px)
        for photo in result.photos
    }
    unit = _unit(result.shape)
    write_cameras_json(folder / "cameras.json", {result.camera_name: result.camera}, poses, unit)
    _write_other_formats(result.camera, folder)
    _write_board(result.shape, folder)
    _write_common(result.common, unit, folder)
    _write_image_points(result, folder)
    _write_photos(result, folder)
    tests = result.intrinsics
    write_table_csv(
        folder / "intrinsics.csv",
        {
            "name": [one.name for one in tests],
            "value": [one.value for one in tests],
            "sigma": [one.sigma for one in tests],
            "significance": [one.significance for one in tests],
            "rival": [one.rival for one in tests],
            "correlation": [one.correlation for one in tests],
        },
    )
    write_table_csv(folder / "rejected.csv", {"image_point": list(result.quality.rejected)})
    left_out = {"image": list(result.left_out), "reason": list(result.left_out.values())}
    write_table_csv(folder / _LEFT_OUT, left_out)
    rms = {photo.name: photo.rms_px for photo in result.photos}
    order = sorted(result.thumbnails, key=lambda name: -rms.get(name, np.inf))
    write_thumbnails(folder, {name: result.thumbnails[name] for name in order})
    if result.compared_with is not None:
        write_camera_json(folder / _COMPARED, result.compared_with)


def _write_other_formats(camera: Camera, folder: Path) -> None:
    """Write the camera as OpenCV and COLMAP read it; a camera with skew is none of theirs."""
    with suppress(InputError):
        write_text(folder / "camera_opencv.yaml", opencv_yaml(camera))
        write_text(folder / "cameras_colmap.txt", colmap_text(camera))


def colmap_text(camera: Camera) -> str:
    """Return a camera as COLMAP's cameras.txt has it.

    camera: A camera without skew whose polynomial goes from ideal to measured.
    InputError: COLMAP's models do not hold the camera.
    """
    model, parameters = to_colmap(camera)
    numbers = " ".join(repr(value) for value in parameters.tolist())
    return (
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"1 {model} {camera.width_px} {camera.height_px} {numbers}\n"
    )


def opencv_yaml(camera: Camera) -> str:
    """Return a camera as ``cv2.FileStorage`` reads it, with the keys of OpenCV's calibration sample.

    camera: A camera without skew whose polynomial goes from ideal to measured.
    Returns: YAML; ``standard_deviations`` follows ``calibrateCameraExtended``: fx, fy, cx, cy, k1, k2, p1, p2, k3.
    InputError: OpenCV's model does not hold the camera.
    """
    matrix, distortion = to_opencv(camera)
    deviations = np.delete(camera.sigma_parameters, PARAMETER_NAMES.index("skew"))
    return (
        f"%YAML:1.0\n---\nimage_width: {camera.width_px}\nimage_height: {camera.height_px}\n"
        + _yaml_matrix("camera_matrix", matrix)
        + _yaml_matrix("distortion_coefficients", distortion[:, None])
        + _yaml_matrix("standard_deviations", deviations[:, None])
    )


def _yaml_matrix(name: str, values: FloatArray) -> str:
    # OpenCV's parser takes 1e-05 for text that goes on; its own files write 1.0e-05.
    numbers = ", ".join(f"{value:.17e}" for value in values.ravel().tolist())
    rows, columns = values.shape
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {numbers} ]\n"


def _write_board(shape: BoardShape, folder: Path) -> None:
    every = shape.board.names
    names = tuple(every[i] for i in shape.seen)
    flags = np.zeros(len(names), dtype=np.uint32)
    unit = _unit(shape)
    table = PointTable(names, shape.points_m, shape.sigma_m, shape.n_rays.astype(np.int64), flags)
    write_points_csv(folder / "points.csv", table, unit)
    drawn = shape.board.points_m[shape.seen]
    columns = {f"drawn_{axis}_{unit}": drawn[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"departure_{axis}_{unit}": shape.departure_m[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"sigma_{axis}_{unit}": shape.sigma_m[:, i] for i, axis in enumerate("xyz")}
    write_table_csv(folder / "board.csv", {"id": list(names), **columns, "unit": [unit] * len(names)})


def _write_common(common: CommonErrors, unit: str, folder: Path) -> None:
    pitch = common.pitch_m
    rows = [
        (name, size, *_COMMON_UNITS.get(name, (unit, pitch)))
        for name, size in zip(common.names, common.effects, strict=True)
    ]
    rows += [(name, size, unit, pitch) for name, size in zip(_POINT_ROWS, common.point, strict=True)]
    write_table_csv(
        folder / _COMMON,
        {
            "what": [row[0] for row in rows],
            "sigma": [float(row[1] * row[3]) for row in rows],
            "unit": [row[2] for row in rows],
        },
    )


def _read_common(folder: Path, pitch_m: float, unit: str) -> CommonErrors:
    """Read what points have in common.

    pitch_m: Unit of the board's effects as the board that was read has it.
    """
    if not (folder / _COMMON).is_file():
        raise InputError(f"{folder}: no {_COMMON}; the camera was calibrated by an earlier version: calibrate it again")
    columns = read_table_csv(folder / _COMMON, ("what", "sigma", "unit"))
    sizes = {
        name: sigma / (pitch_m if own == unit else 1.0)
        for name, sigma, own in zip(columns["what"], _floats(columns["sigma"]), columns["unit"], strict=True)
    }
    missing = [name for name in _POINT_ROWS if name not in sizes]
    if missing or not all(0 < size < np.inf for size in sizes.values()):
        raise InputError(f"{folder / _COMMON}: {', '.join(missing) or 'a sigma'} is missing; calibrate again")
    point = np.array([sizes.pop(name) for name in _POINT_ROWS])
    return CommonErrors(tuple(sizes), np.array(list(sizes.values())), point, pitch_m)


def _unit(shape: BoardShape) -> str:
    """Return with what the names of lengths end: metres, or the board's pitch where that is not known."""
    return _METRES if shape.board.is_metric else _PITCHES


def _write_image_points(result: Findings, folder: Path) -> None:
    every = result.shape.board.names
    columns: dict[str, list[object]] = {key: [] for key in _IMAGE_COLUMNS}
    for photo in result.photos:
        kept = np.where(photo.used, 0, int(SampleFlag.OUTLIER))
        sigma = np.sqrt(np.einsum("nii->ni", photo.covariance_px2))
        rows = (
            [photo.name] * photo.index.size,
            [every[i] for i in photo.index],
            *photo.pixels_px.T.tolist(),
            *photo.residuals_px.T.tolist(),
            *sigma.T.tolist(),
            (photo.covariance_px2[:, 0, 1] / sigma.prod(axis=1)).tolist(),
            kept.tolist(),
        )
        for key, values in zip(_IMAGE_COLUMNS, rows, strict=True):
            columns[key] += values
    write_table_csv(folder / "image_points.csv", columns)


def _write_photos(result: Findings, folder: Path) -> None:
    angles = np.degrees([tilt_and_roll(photo.cam_from_board) for photo in result.photos])
    distances = [float(np.linalg.norm(photo.cam_from_board.translation_m)) for photo in result.photos]
    used = {
        "image": [photo.name for photo in result.photos],
        "use": ["calibration"] * len(result.photos),
        "points": [int(photo.index.size) for photo in result.photos],
        "rejected": [int(np.count_nonzero(~photo.used)) for photo in result.photos],
        "rms_px": [photo.rms_px for photo in result.photos],
        "noise_ratio": [photo.noise_ratio for photo in result.photos],
        "kept_apart_px": [photo.kept_apart_px for photo in result.photos],
        "kept_apart_expected_px": [photo.kept_apart_expected_px for photo in result.photos],
        "tilt_deg": angles[:, 0].tolist(),
        "roll_deg": angles[:, 1].tolist(),
        f"distance_{_unit(result.shape)}": distances,
    }
    for check in result.held_out:
        tilt, roll = np.degrees(tilt_and_roll(check.cam_from_board)).tolist()
        distance = float(np.linalg.norm(check.cam_from_board.translation_m))
        numbers = (check.count, 0, check.rms_px, np.nan, check.rms_px, np.nan, tilt, roll, distance)
        row = (check.name, "held out", *numbers)
        for key, value in zip(used, row, strict=True):
            used[key].append(value)
    write_table_csv(folder / "photos.csv", used)


def read_tables(folder: Path, form: type[_Form]) -> _Form:
    """Read what `write_tables` and the summary hold.

    form: What to make of it.
    Returns: As `calibration.camera.files.result.open_calibration` says.
    """
    summary = read_summary(folder / "summary.json")
    is_metric = _METRES in read_table_csv(folder / "board.csv", ("unit",))["unit"]
    unit = _METRES if is_metric else _PITCHES
    cameras, poses = read_cameras_json(folder / "cameras.json", unit)
    camera_name, camera = next(iter(cameras.items()))
    drawn_rms = summary.numbers.get("residual_rms_board_as_drawn_px")
    shape = _read_shape(folder, summary.texts, unit, has_drawing=drawn_rms is not None)
    needed = ("image", "use", "points", "rms_px", "noise_ratio", "kept_apart_px", "kept_apart_expected_px")
    photo_table = read_table_csv(folder / "photos.csv", needed)
    of_each = zip(*(_floats(photo_table[key]) for key in needed[4:]), strict=True)
    photos = _read_photos(folder, shape, poses, dict(zip(photo_table["image"], of_each, strict=True)))
    numbers = summary.numbers
    pixels = np.concatenate([photo.pixels_px[photo.used] for photo in photos])
    distance = float(np.median([np.linalg.norm(photo.cam_from_board.translation_m) for photo in photos]))
    other = read_camera_json(folder / _COMPARED) if (folder / _COMPARED).exists() else None
    left_out = read_table_csv(folder / _LEFT_OUT, ("image", "reason"))
    return form(
        camera_name,
        camera,
        _read_intrinsics(folder),
        photos,
        dict(zip(left_out["image"], left_out["reason"], strict=True)),
        shape,
        _read_common(folder, shape.board.pitch_m, unit),
        Quality(
            float(numbers.get("residual_rms_px") or np.nan),
            float(drawn_rms or np.nan),
            float(numbers.get("residual_over_noise_ratio") or np.nan),
            int(numbers.get("redundancy_count") or 0),
            tuple(read_table_csv(folder / "rejected.csv", ("image_point",))["image_point"]),
        ),
        sigma_map(camera, distance),
        radial_profile(camera, pixels),
        coverage(camera, pixels),
        _read_checks(photo_table),
        None if other is None else compare(camera, other),
        other,
        read_thumbnails(folder, (*poses, *left_out["image"])),
        name=summary.name,
        doubts=summary.doubts,
        durations_s=summary.durations_s,
        input_sha256=summary.input_sha256,
    )


def _floats(cells: list[str]) -> list[float]:
    return [float(cell) if cell else float("nan") for cell in cells]


def _read_shape(folder: Path, texts: Mapping[str, str], unit: str, *, has_drawing: bool) -> BoardShape:
    points = read_points_csv(folder / "points.csv", unit)
    names = [f"drawn_{axis}_{unit}" for axis in "xyz"]
    columns = read_table_csv(folder / "board.csv", ("id", *names))
    drawn = np.array([_floats(columns[name]) for name in names]).T
    board = TargetField("", tuple(points.ids), drawn, is_metric=unit == _METRES)
    held = not points.sigma_m.any()
    return BoardShape(
        board,
        np.arange(len(points.ids)),
        points.xyz_m,
        points.sigma_m,
        points.n_rays,
        np.zeros(3) if held else np.full(3, np.nan if has_drawing else np.inf),
        texts.get("datum", ""),
    )


def _read_photos(
    folder: Path, shape: BoardShape, poses: dict[str, PhotoPose], of_each: dict[str, tuple[float, ...]]
) -> tuple[PhotoResult, ...]:
    columns = read_table_csv(folder / "image_points.csv", _IMAGE_COLUMNS)
    images = np.array(columns["image"])
    place = {name: i for i, name in enumerate(shape.board.names)}
    index = np.array([place.get(name, -1) for name in columns["target"]], dtype=np.intp)
    x, y, dx, dy, sigma_x, sigma_y, rho = (np.array(_floats(columns[name])) for name in _IMAGE_NUMBERS)
    sigma = np.stack([sigma_x, sigma_y], axis=1)
    correlation = np.where(np.eye(2, dtype=np.bool_), 1.0, rho[:, None, None])
    covariance = correlation * (sigma[:, :, None] * sigma[:, None])
    photos = []
    for name, pose in poses.items():
        own = images == name
        photos.append(
            PhotoResult(
                name,
                pose.cam_from_world,
                pose.covariance,
                index[own],
                np.stack([x[own], y[own]], axis=1),
                np.stack([dx[own], dy[own]], axis=1),
                covariance[own],
                *of_each.get(name, (float("nan"),) * 3),
            )
        )
    return tuple(photos)


def _read_intrinsics(folder: Path) -> tuple[Intrinsic, ...]:
    columns = read_table_csv(folder / "intrinsics.csv", ("name", "value", "sigma", "significance", "rival"))
    numbers = [_floats(columns[name]) for name in ("value", "sigma", "significance", "correlation")]
    return tuple(
        Intrinsic(name, value, sigma, significance, rival, correlation)
        for name, rival, value, sigma, significance, correlation in zip(
            columns["name"], columns["rival"], *numbers, strict=True
        )
    )


def _read_checks(columns: dict[str, list[str]]) -> tuple[HeldOutPhoto, ...]:
    rows = zip(columns["image"], columns["use"], columns["points"], columns["rms_px"], strict=True)
    return tuple(
        HeldOutPhoto(name, RigidTransform.identity(), int(count), float(rms))
        for name, use, count, rms in rows
        if use == "held out"
    )
