"""Turn the files of an OpenCSP/SOFAST measurement into a measurement folder."""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from deflectometry.exchange.opencsp_files import (
    STEPS_DEG,
    CalculationRecord,
    CameraRecord,
    DotPhotoRecord,
    DotTableRecord,
    EnsembleRecord,
    FacetRecord,
    FocalLengthRecord,
    FringeRecord,
    OpencspFile,
    RectangleRecord,
    ResponseRecord,
    TableRecord,
    read_opencsp_file,
)
from deflectometry.exchange.slope_files import SLOPES_FILE, write_points, write_slopes_measurement
from deflectometry.exchange.slope_points import SlopePoints, points_words
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.photos import write_image
from heliogauge.measurement.imported import IMPORTED, write_imported
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.tables import write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, positive

_T = TypeVar("_T")

#: Usual standard deviations of set-ups: of the camera as shares of its focal length, of the screen in mrad and mm.
#: laboratory: camera from photos of a board, screen from photogrammetry or a laser tracker. hand: camera from a few
#: photos or the lens's label, screen with tape and level.
USUAL_SIGMAS = {"laboratory": (0.001, 1.0, 5.0), "hand": (0.005, 5.0, 20.0)}


@dataclass(frozen=True, slots=True)
class SetupSigmas(ShortRepr):
    """How well the camera and the screen of other programs' files are known, which the files do not say.

    usual: A set-up of which the usual values hold where nothing else is stated: ``laboratory`` or ``hand``
        (`USUAL_SIGMAS`); unknown: no sigma is written, so that each value counts as known no better than the images
        know it.
    focal_px: Standard deviation of the focal length [px].
    center_px: Standard deviation of each coordinate of the principal point [px].
    screen_mrad: Standard deviation of the screen's rotation about each axis [mrad].
    screen_mm: Standard deviation of the screen's place along each axis, and of its width, height and sag [mm].
    """

    usual: Literal["laboratory", "hand", "unknown"] = "unknown"
    focal_px: float | None = None
    center_px: float | None = None
    screen_mrad: float | None = None
    screen_mm: float | None = None

    def of_camera(self, focal_px: float) -> dict[str, float]:
        """Return the keys of ``[camera]`` for a focal length [px]."""
        share = USUAL_SIGMAS[self.usual][0] if self.usual in USUAL_SIGMAS else None
        usual_px = None if share is None else float(f"{share * focal_px:.3g}")
        return _stated(
            {
                "sigma_focal_px": usual_px if self.focal_px is None else self.focal_px,
                "sigma_center_px": usual_px if self.center_px is None else self.center_px,
            }
        )

    def of_screen(self) -> dict[str, float]:
        """Return the keys of ``[screen]``."""
        _, usual_mrad, usual_mm = USUAL_SIGMAS.get(self.usual, (None, None, None))
        length_mm = usual_mm if self.screen_mm is None else self.screen_mm
        lengths = ("translation", "width", "height", "sag")
        return _stated(
            {"sigma_rotation_mrad": usual_mrad if self.screen_mrad is None else self.screen_mrad}
            | {f"sigma_{name}_mm": length_mm for name in lengths}
        )

    def words(self) -> str:
        """Return what is stated in one line."""
        texts = [
            f"{name.replace('_', ' ')} {value:g}"
            for name, value in (
                ("focal_px", self.focal_px),
                ("center_px", self.center_px),
                ("screen_mrad", self.screen_mrad),
                ("screen_mm", self.screen_mm),
            )
            if value is not None
        ]
        if self.usual in USUAL_SIGMAS:
            share, angle_mrad, length_mm = USUAL_SIGMAS[self.usual]
            usual = f"usual in a {self.usual}" if self.usual == "laboratory" else "usual by hand"
            texts.append(
                f"{usual}: camera {share:.1%} of the focal length, screen {angle_mrad:g} mrad and {length_mm:g} mm"
            )
        if texts:
            return f"sigmas of camera and screen: {'; '.join(texts)}"
        return (
            "sigmas of camera and screen: unknown; state them (--sigma-focal-px, --sigma-center-px, "
            "--sigma-screen-mrad, --sigma-screen-mm), or take usual ones: --sigmas laboratory | hand"
        )


def _stated(keys: dict[str, float | None]) -> dict[str, float]:
    return {key: positive(key, value, key.rsplit("_", 1)[1]) for key, value in keys.items() if value is not None}


@dataclass(frozen=True, slots=True)
class OpencspOptions(ShortRepr):
    """What the files leave open.

    pose_from: SOFAST result file whose pose of the mirror is taken over; otherwise the pose is found from the
        outline.
    correct_principal_point: Move the principal point of averaged images to where averaging put it.
    focal_length_m: Focal length of the design paraboloid [m]; otherwise the start value of a result file, otherwise
        a plane.
    sigma_distance_mm: Standard deviation of the measured distance, which the files do not hold [mm].
    known_dots: Dots whose places in the photo someone knows, one for each facet: x and y [px], column and row; empty:
        a point light tells.
    sigmas: How well camera and screen are known.
    """

    pose_from: Path | None = None
    correct_principal_point: bool = False
    focal_length_m: float | None = None
    sigma_distance_mm: float = 10.0
    known_dots: tuple[tuple[float, float, int, int], ...] = ()
    sigmas: SetupSigmas = field(default_factory=SetupSigmas)


def parse_known_dot(text: str) -> tuple[float, float, int, int]:
    """Return a known dot from its text.

    InputError: It is not of that form.

    >>> parse_known_dot("853,680,0,0")
    (853.0, 680.0, 0, 0)
    """
    try:
        x, y, column, row = text.split(",")
        return float(x), float(y), int(column), int(row)
    except ValueError:
        raise InputError(f"known dot {text!r}: x and y in the photo, column and row are needed: 853,680,0,0") from None


@dataclass(frozen=True, slots=True)
class Imported:
    """What an import took.

    taken: What was taken from which file, one line each.
    doubts: What must be looked at in the measurement folder.
    """

    taken: tuple[str, ...]
    doubts: tuple[Doubt, ...]


def import_opencsp(
    files: Sequence[Path], folder: Path, options: OpencspOptions | None = None, *, force: bool = False
) -> Imported:
    """Write a measurement folder from OpenCSP files, given in any order and recognised by their content.

    With a fringe measurement it is one of ``kind = "deflectometry"``, with a photo of dots one of
    ``kind = "deflectometry-dots"``; a result file without one gives the slopes that
    SOFAST found, as ``kind = "slopes"``.

    files: HDF5 and JSON files: measurement, camera, display shape, spatial orientation, facet definition, and where
        there are any image calibration, ensemble definition and result file. A file made for one purpose wins over
        the copy inside a result file.
    folder: Where to write; it must be empty or not there yet.
    options: What the files leave open.
    Returns: What was taken from which file, one line each, and what is doubtful about it.
    InputError: A kind of file is missing, given twice, not readable, or does not fit the others.

    The measured distance is written as an observation with its sigma. SOFAST instead shifts the mirror until it is
    met exactly.
    """
    with WholeFolder(folder, IMPORTED, force=force) as working:
        parts = _Parts([read_opencsp_file(Path(path)) for path in files])
        chosen = options or OpencspOptions()
        of_dots = parts.holds(DotPhotoRecord) and not parts.holds(FringeRecord)
        if chosen.known_dots and not of_dots:
            raise InputError("known dots: no file given holds a photo of dots (MeasurementSofastFixed); leave them out")
        if of_dots:
            _write_dots(working, parts, chosen)
        elif parts.holds(CalculationRecord) and not parts.holds(FringeRecord):
            if chosen.sigmas != SetupSigmas():
                raise InputError("sigmas: slopes have neither camera nor screen; leave them out")
            _write_slopes(working, parts, chosen)
        else:
            _write(working, parts, chosen)
        write_imported(working, "opencsp", [Path(path) for path in files])
    return Imported(tuple(parts.taken), tuple(parts.doubts))


def _write(working: Path, parts: "_Parts", options: OpencspOptions) -> None:
    """Write the measurement that the records make up."""
    fringes = parts.needed(FringeRecord, "a fringe measurement (MeasurementSofastFringe)")
    height_px, width_px = fringes.dark_dn.shape
    content: dict[str, Any] = {"kind": "deflectometry", "name": fringes.name or "OpenCSP measurement"}
    date = _date(fringes.date)
    if date is not None:
        content["date"] = date
    content["camera"] = _camera_section(parts, (height_px, width_px), options)
    screen, table = _screen_section(
        parts.needed(RectangleRecord | TableRecord, "a display shape (DisplayShape)"),
        parts.needed(RigidTransform, "the camera's orientation to the screen (SpatialOrientation)"),
    )
    content["screen"] = screen | options.sigmas.of_screen()
    response = parts.wanted(ResponseRecord)
    if response is not None:
        content["screen"]["response_file"] = "response.csv"
    content["pattern"] = {"set": _pattern_sets(fringes)}
    content["images"] = {"fringes": "fringe_*.png", "dark": "dark.png", "bright": "bright.png"}
    content["mirror"] = _mirror_section(parts, fringes.distance_m, fringes.measure_point_m, options)
    count = fringes.frames_dn.shape[2]
    named = [(f"fringe_{index:03d}.png", fringes.frames_dn[..., index]) for index in range(count)]
    images = _storable([*named, ("dark.png", fringes.dark_dn), ("bright.png", fringes.bright_dn)])
    # Everything is checked before the first file is written.
    parse_measurement(content, Path("measurement.toml"))
    for name, image in images:
        write_image(working / name, np.ascontiguousarray(image))
    if table is not None:
        write_table_csv(working / "screen_points.csv", table)
    if response is not None:
        columns = {"camera_dn": response.camera_dn, "display_level": response.display_level}
        write_table_csv(working / "response.csv", columns)
    write_measurement(working, content, comment="Imported from OpenCSP/SOFAST files.")


def _write_dots(working: Path, parts: "_Parts", options: OpencspOptions) -> None:
    """Write the measurement that a photo of dots and its records make up.

    The origin that the file gives is left out: SOFAST finds it by a point light, and so does the measurement.
    """
    photo: DotPhotoRecord = parts.needed(DotPhotoRecord, "a photo of dots (MeasurementSofastFixed)")
    dots: DotTableRecord = parts.needed(DotTableRecord, "the places of the dots (DotLocationsFixedPattern)")
    content: dict[str, Any] = {"kind": "deflectometry-dots", "name": photo.name or "OpenCSP measurement"}
    date = _date(photo.date)
    if date is not None:
        content["date"] = date
    height_px, width_px = photo.photo_dn.shape
    content["photo"] = "photo.png"
    content["camera"] = _camera_section(parts, (height_px, width_px), options)
    pose = parts.needed(RigidTransform, "the camera's orientation to the screen (SpatialOrientation)")
    content["screen"] = {"shape": "dots", "file": "dots.csv"} | _pose_keys(pose) | options.sigmas.of_screen()
    content["pattern"] = {"dots": "dark", "origin": "light"}
    if options.known_dots:
        known = [{"image_px": [x, y], "column": column, "row": row} for x, y, column, row in options.known_dots]
        content["pattern"] = {"dots": "dark", "known_dot": known}
    content["mirror"] = _mirror_section(parts, photo.distance_m, photo.measure_point_m, options)
    images = _storable([("photo.png", photo.photo_dn)])
    parse_measurement(content, Path("measurement.toml"))
    for name, image in images:
        write_image(working / name, np.ascontiguousarray(image))
    x_m, y_m, z_m = dots.xyz_m.T
    numbers = {"column": dots.column.astype(np.intp), "row": dots.row.astype(np.intp)}
    write_table_csv(working / "dots.csv", {**numbers, "x_m": x_m, "y_m": y_m, "z_m": z_m})
    write_measurement(working, content, comment="Imported from OpenCSP/SOFAST files.")


def _write_slopes(working: Path, parts: "_Parts", options: OpencspOptions) -> None:
    """Write the slopes of a result file; several facets stand where the ensemble has them."""
    found: CalculationRecord = parts.needed(CalculationRecord, "a SOFAST result (DataSofastCalculation)")
    facets = parts.wanted_all(FacetRecord)
    count = len(found.slopes)
    if not count:
        raise InputError(f"{parts.taken[-1]}: it holds no slopes (SlopeSolverData)")
    places: tuple[RigidTransform, ...] = (RigidTransform.identity(),)
    if count > 1:
        places = parts.needed(EnsembleRecord, "an ensemble definition, which several facets need").ensemble_from_facet
    if len(facets) == 1:
        facets = facets * count
    if len(places) != count or len(facets) not in (0, count):
        raise InputError(
            f"{', '.join(parts.taken)}: slopes of {count} facets, places of {len(places)}, outlines of {len(facets)}"
        )
    pieces = []
    for number, (points, slopes) in enumerate(zip(found.surface_points_m, found.slopes, strict=True)):
        values = np.concatenate([points, slopes])
        if facets:
            # Corners without slopes: what of the facet SOFAST did not measure is counted.
            corners = facets[number].corners_m
            values = np.concatenate([values, np.vstack([corners.T, np.full((2, len(corners)), np.nan)])], axis=1)
        normals = places[number].rotation @ np.stack([-values[3], -values[4], np.ones(values.shape[1])])
        x, y, _ = places[number].apply(values[:3].T).T
        pieces.append(np.stack([x, y, -normals[0] / normals[2], -normals[1] / normals[2]]))
    x, y, slope_x, slope_y = np.concatenate(pieces, axis=1)
    unknown = np.full(x.size, np.nan)
    points_found = SlopePoints(x, y, slope_x, slope_y, unknown, unknown)
    # Of several facets SOFAST's focal length is that of each about its own middle.
    design = _design_keys(parts, options) if count == 1 or options.focal_length_m else {"design": "plane"}
    write_points(working / SLOPES_FILE, points_found)
    write_slopes_measurement(working, "OpenCSP result", SLOPES_FILE, design, "Slopes imported from an OpenCSP result.")
    parts.taken.append(points_words(points_found))


def _date(text: str) -> datetime.datetime | None:
    try:
        return datetime.datetime.fromisoformat(text)
    except ValueError:
        return None


_WORDS: dict[type, str] = {
    FringeRecord: "fringe measurement",
    DotPhotoRecord: "photo of dots",
    DotTableRecord: "places of the dots",
    CameraRecord: "camera",
    RectangleRecord: "display shape (rectangle)",
    TableRecord: "display shape (table)",
    RigidTransform: "orientation of camera and screen",
    ResponseRecord: "camera-display response",
    FacetRecord: "facet definition",
    EnsembleRecord: "ensemble definition",
    FocalLengthRecord: "design focal length",
    CalculationRecord: "slopes of SOFAST",
}


class _Parts:
    """The records of all files, with notes of what was taken from where and what is doubtful."""

    def __init__(self, files: list[OpencspFile]) -> None:
        self.files = files
        self.taken: list[str] = []
        self.doubts: list[Doubt] = []

    def holds(self, kind: type) -> bool:
        """Tell whether a file has a record of a kind."""
        return any(isinstance(record, kind) for file in self.files for record in file.records)

    def wanted_all(self, kind: type[_T]) -> list[_T]:
        """Return the records of a kind: from files made for it, else from result files."""
        for is_result in (False, True):
            found = [
                (file.name, record)
                for file in self.files
                if file.is_result is is_result
                for record in file.records
                if isinstance(record, kind)
            ]
            if found:
                what = _WORDS[type(found[0][1])]
                self.taken.append(f"{what}: {', '.join(dict.fromkeys(name for name, _ in found))}")
                return [record for _, record in found]
        return []

    def wanted(self, kind: type[_T]) -> _T | None:
        """Return the one record of a kind, or None."""
        found = self.wanted_all(kind)
        if len(found) > 1:
            raise InputError(f"{self.taken[-1]}: {len(found)} of one kind were given, which one is meant? Leave one")
        return found[0] if found else None

    def needed(self, kind: Any, words: str) -> Any:
        """Return the one record of a kind."""
        record = self.wanted(kind)
        if record is None:
            raise InputError(f"no file given holds {words}; files read: {', '.join(file.name for file in self.files)}")
        return record


def _camera_section(parts: _Parts, shape: tuple[int, int], options: OpencspOptions) -> dict[str, Any]:
    camera: CameraRecord = parts.needed(CameraRecord, "a camera (Camera)")
    width_px, height_px = camera.size_for(*shape)
    if options.correct_principal_point:
        camera = camera.corrected()
    elif camera.averaged > 1.001:
        text = (
            f"camera '{camera.name}' belongs to images averaged over {camera.averaged:.4g} x {camera.averaged:.4g} px,"
            f" but its principal point misses the shift of {camera.principal_point_shift_px:.4f} px that averaging"
            " causes; imported as given (import again with correct_principal_point=True to repair it)"
        )
        parts.doubts.append(Doubt("principal_point_not_shifted", text, {"shift_px": camera.principal_point_shift_px}))
    parts.taken.append(options.sigmas.words())
    k1, k2, p1, p2, k3 = camera.distortion.tolist()
    return {
        "width_px": width_px,
        "height_px": height_px,
        "focal_x_px": float(camera.matrix[0, 0]),
        "focal_y_px": float(camera.matrix[1, 1]),
        "center_x_px": float(camera.matrix[0, 2]),
        "center_y_px": float(camera.matrix[1, 2]),
        "skew": float(camera.matrix[0, 1]),
        "k1": k1,
        "k2": k2,
        "k3": k3,
        "p1": p1,
        "p2": p2,
        "distortion_direction": "ideal_to_measured",
    } | options.sigmas.of_camera(float(camera.matrix[0, 0]))


def _screen_section(
    display: RectangleRecord | TableRecord, cam_from_screen: RigidTransform
) -> tuple[dict[str, Any], dict[str, FloatArray] | None]:
    table = None
    if isinstance(display, RectangleRecord):
        section: dict[str, Any] = {"shape": "rectangle", "width_m": display.width_m, "height_m": display.height_m}
    else:
        section = {"shape": "table", "file": "screen_points.csv"}
        x_m, y_m, z_m = display.xyz_m.T
        table = {"u": display.u, "v": display.v, "x_m": x_m, "y_m": y_m, "z_m": z_m}
    return section | _pose_keys(cam_from_screen), table


def _pose_keys(pose: RigidTransform) -> dict[str, Any]:
    return {
        "rotation_vector_rad": pose.rotation_vector_rad.tolist(),
        "translation_m": pose.translation_m.tolist(),
    }


def _pattern_sets(fringes: FringeRecord) -> list[dict[str, Any]]:
    return [
        {"axis": axis, "periods": float(periods), "steps_deg": list(STEPS_DEG)}
        for axis, all_periods in (("y", fringes.periods_y), ("x", fringes.periods_x))
        for periods in all_periods
    ]


def _mirror_section(
    parts: _Parts, distance_m: float, measure_point_m: FloatArray, options: OpencspOptions
) -> dict[str, Any]:
    design = _design_keys(parts, options)
    section: dict[str, Any] = {}
    facets = parts.wanted_all(FacetRecord)
    ensemble = parts.wanted(EnsembleRecord)
    if not facets:
        if ensemble is not None:
            raise InputError("an ensemble definition, but no file given holds a facet definition (v_facet_corners)")
        text = (
            "no file given holds a facet definition: the mirror is taken as undefined, so that what shows fringes is "
            "the mirror, and its frame is where its middle is seen; give the definition (JSON with v_facet_corners) to "
            "compare with the design at its place"
        )
        parts.doubts.append(Doubt("facet_definition_missing", text))
        section |= design
    elif ensemble is None:
        if len(facets) > 1:
            raise InputError(
                f"{parts.taken[-1]}: {len(facets)} facets, but no ensemble definition (JSON with v_facet_locations)"
            )
        section |= design
        section["outline_m"] = _outline(facets[0])
        section["reference_point_m"] = facets[0].centroid_m[:2].tolist()
    else:
        # SOFAST's focal length is that of each facet about its own middle, not of the whole mirror.
        section["facet"] = [facet | design for facet in _facet_tables(facets, ensemble)]
    positive("sigma_distance_mm", options.sigma_distance_mm, "mm")
    section["distance"] = {
        "distance_m": distance_m,
        "sigma_mm": options.sigma_distance_mm,
        "point_m": measure_point_m.tolist(),
    }
    if options.pose_from is not None:
        section["pose"] = _pose_keys(_result_pose(options.pose_from))
        parts.taken.append(f"pose of the mirror: {options.pose_from.name}")
    return section


def _design_keys(parts: _Parts, options: OpencspOptions) -> dict[str, Any]:
    if options.focal_length_m is not None:
        return {"design": "paraboloid", "focal_length_m": positive("focal length", options.focal_length_m, "metres")}
    start = parts.wanted(FocalLengthRecord)
    if start is None:
        text = (
            "no file given holds the design focal length; the design is written as a plane, so slope errors will"
            " contain the mirror's curvature (give focal_length_m=F, or edit [mirror] in measurement.toml)"
        )
        parts.doubts.append(Doubt("design_focal_length_missing", text))
        return {"design": "plane"}
    if start.focal_length_x_m == start.focal_length_y_m:
        return {"design": "paraboloid", "focal_length_m": start.focal_length_x_m}
    return {
        "design": "paraboloid_xy",
        "focal_length_x_m": start.focal_length_x_m,
        "focal_length_y_m": start.focal_length_y_m,
    }


def _facet_tables(facets: list[FacetRecord], ensemble: EnsembleRecord) -> list[dict[str, Any]]:
    count = len(ensemble.ensemble_from_facet)
    if len(facets) == 1:
        facets = facets * count
    if len(facets) != count:
        raise InputError(f"the ensemble definition has {count} facets, but {len(facets)} facet definitions were given")
    return [
        {
            "name": f"facet_{index:03d}",
            "outline_m": _outline(facet),
            "reference_point_m": facet.centroid_m[:2].tolist(),
            "position_m": place.translation_m.tolist(),
            "rotation_vector_rad": place.rotation_vector_rad.tolist(),
        }
        for index, (facet, place) in enumerate(zip(facets, ensemble.ensemble_from_facet, strict=True))
    ]


def _outline(facet: FacetRecord) -> list[list[float]]:
    """Return the corners counter-clockwise seen from the front; OpenCSP's examples go the other way round."""
    corners = facet.corners_m[:, :2]
    following = np.roll(corners, -1, axis=0)
    doubled_area = float((corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]).sum())
    ordered: list[list[float]] = (corners if doubled_area > 0 else corners[::-1]).tolist()
    return ordered


def _result_pose(path: Path) -> RigidTransform:
    for record in read_opencsp_file(path).records:
        if isinstance(record, CalculationRecord) and record.cam_from_mirror is not None:
            return record.cam_from_mirror
    raise InputError(f"{path.name}: no SOFAST result (DataSofastCalculation) in it, so no pose of the mirror")


def _storable(images: list[tuple[str, npt.NDArray[Any]]]) -> list[tuple[str, npt.NDArray[Any]]]:
    """Return the images with their names, in an integer type that a PNG keeps without loss."""
    dtypes = {image.dtype for _, image in images}
    if dtypes <= {np.dtype(np.uint8), np.dtype(np.uint16)}:
        return images
    values = np.concatenate([image.reshape(-1) for _, image in images])
    whole = values.dtype.kind in "biuf" and np.isfinite(values).all() and np.all(values == np.rint(values))
    if not (whole and 0 <= values.min() <= values.max() < 65536):
        raise InputError(
            f"frames of type {', '.join(map(str, dtypes))} hold values that are no whole numbers from 0 to 65535; PNG"
            " cannot keep them without loss"
        )
    wanted = np.uint8 if values.max() < 256 else np.uint16
    return [(name, image.astype(wanted)) for name, image in images]
