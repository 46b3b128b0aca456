"""Read what OpenCSP/SOFAST writes: HDF5 measurements, cameras, displays, poses, and JSON optic definitions.

Conventions of these files, all converted here: rotations are rotation vectors named ``r_from_to``, vectors are named
``v_from_to_frame``; the screen fraction y counts from the bottom (ours, v, from the top); the y fringes come before
the x fringes; each period has four frames a quarter of a period apart.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.files.hdf5 import is_hdf5, open_hdf5
from heliogauge.files.texts import read_json
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray, float_array, positive

#: Frames per period and the phase step between them; SOFAST knows no other pattern.
STEPS_DEG = (0.0, 90.0, 180.0, 270.0)


@dataclass(frozen=True, slots=True, eq=False)
class FringeRecord:
    """Frames and notes of one fringe measurement.

    name, date: As written in the file; empty where absent.
    frames_dn (h, w, n): Fringe frames in the order of the file: y fringes, then x fringes [DN].
    dark_dn, bright_dn (h, w): The two mask images [DN].
    periods_y, periods_x: Periods per display height and width.
    distance_m: Measured distance from the measure point to the origin of the screen [m].
    measure_point_m (3,): The point on the mirror it was measured to, in mirror coordinates [m].
    """

    name: str
    date: str
    frames_dn: npt.NDArray[Any]
    dark_dn: npt.NDArray[Any]
    bright_dn: npt.NDArray[Any]
    periods_y: FloatArray
    periods_x: FloatArray
    distance_m: float
    measure_point_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DotPhotoRecord:
    """The photo and notes of one fixed-pattern measurement (SofastFixed).

    name, date: As written in the file; empty where absent.
    photo_dn (h, w): The photo [DN].
    origin_px (k, 2): Where a point light beside dot (0, 0) was found, one for each facet [px].
    distance_m: Measured distance from the measure point to the origin of the screen [m].
    measure_point_m (3,): The point on the mirror it was measured to, in mirror coordinates [m].
    """

    name: str
    date: str
    photo_dn: npt.NDArray[Any]
    origin_px: FloatArray
    distance_m: float
    measure_point_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class DotTableRecord:
    """Places of the dots of a fixed pattern: columns (to the right) and rows (upwards), xyz (n, 3) [m]."""

    column: FloatArray
    row: FloatArray
    xyz_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CameraRecord:
    """Camera parameters in OpenCV's meaning, scaled to the images they are for.

    name: As written in the file.
    image_shape: The two numbers of ``image_shape_xy``; some files hold (height, width).
    matrix (3, 3): Camera matrix with ``matrix[2, 2] == 1``.
    distortion (5,): k1, k2, p1, p2, k3.
    averaged: How many pixels were averaged along each axis (1 / K[2, 2] of the file: the writer divided the whole
        matrix).
    """

    name: str
    image_shape: tuple[int, int]
    matrix: FloatArray
    distortion: FloatArray
    averaged: float

    @property
    def principal_point_shift_px(self) -> float:
        """What the principal point lacks after averaging n x n pixels, -(n - 1) / (2 n) [px].

        Full-size pixel x lies at (x - (n - 1) / 2) / n of the averaged image; the writer only divided by n.
        """
        return -(self.averaged - 1) / (2 * self.averaged)

    def corrected(self) -> "CameraRecord":
        """Return the camera with the principal point where averaging put it."""
        matrix = np.array(self.matrix)
        matrix[:2, 2] += self.principal_point_shift_px
        return replace(self, matrix=matrix)

    def size_for(self, height_px: int, width_px: int) -> tuple[int, int]:
        """Return (width, height), whichever order the file has.

        height_px, width_px: Shape of the frames [px].
        InputError: The camera is for images of another size.
        """
        if sorted(self.image_shape) != sorted((width_px, height_px)):
            raise InputError(
                f"Camera '{self.name}' is for images of {self.image_shape[0]} x {self.image_shape[1]} px, the frames"
                f" are {width_px} x {height_px} px (width x height): give the camera file of the same image size"
            )
        return width_px, height_px


@dataclass(frozen=True, slots=True, eq=False)
class RectangleRecord:
    """A flat rectangular display, ``rectangular2D``, of a width and a height [m]."""

    name: str
    width_m: float
    height_m: float


@dataclass(frozen=True, slots=True, eq=False)
class TableRecord:
    """A display known by points (``distorted2D``, ``distorted3D``): (u, v) with v from the top, xyz (n, 3) [m]."""

    name: str
    u: FloatArray
    v: FloatArray
    xyz_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ResponseRecord:
    """Camera digital numbers for levels sent to the display, both of shape (n,)."""

    camera_dn: FloatArray
    display_level: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FacetRecord:
    """Outline of one facet: corners of shape (n, 3) and centroid of shape (3,), in facet coordinates [m]."""

    corners_m: FloatArray
    centroid_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class EnsembleRecord:
    """Where the facets of a mirror stand: one ``ensemble_from_facet`` each, and the ensemble's centroid [m]."""

    ensemble_from_facet: tuple[RigidTransform, ...]
    centroid_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CalculationRecord:
    """What SOFAST computed: its pose of the mirror, its slopes (a comparison, not a truth) and its start shape.

    cam_from_mirror: Pose of the mirror; None in files that hold none.
    surface_points_m (3, n): Points of each facet [m].
    slopes (2, n): dz/dx and dz/dy at these points.
    """

    cam_from_mirror: RigidTransform | None
    surface_points_m: tuple[FloatArray, ...]
    slopes: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FocalLengthRecord:
    """The paraboloid that SOFAST started from: focal lengths along x and y [m]."""

    focal_length_x_m: float
    focal_length_y_m: float


Record = (
    FringeRecord
    | DotPhotoRecord
    | DotTableRecord
    | CameraRecord
    | RectangleRecord
    | TableRecord
    | ResponseRecord
    | FacetRecord
    | EnsembleRecord
    | CalculationRecord
    | FocalLengthRecord
    | RigidTransform
)


@dataclass(frozen=True, slots=True, eq=False)
class OpencspFile:
    """Everything recognised in one file; `is_result` where SOFAST wrote it after its own evaluation."""

    name: str
    records: tuple[Record, ...]
    is_result: bool


def read_opencsp_file(path: Path) -> OpencspFile:
    """Read one OpenCSP file, recognising what it holds by its content.

    InputError: Not readable, nothing recognised, or a part missing.
    """
    if is_hdf5(path):
        with open_hdf5(path) as file:
            records = tuple(_hdf5_records(path.name, file))
            is_result = "DataSofastCalculation" in file
    else:
        records, is_result = tuple(_json_records(path)), False
    if not records:
        raise InputError(
            f"{path.name}: nothing of a fringe measurement recognised in it (looked for {', '.join(_READERS)}, and for"
            " facet and ensemble definitions)"
        )
    return OpencspFile(path.name, records, is_result)


class _Node:
    """One HDF5 group with messages that name the file."""

    def __init__(self, file_name: str, group: h5py.Group) -> None:
        self.file_name = file_name
        self.group = group
        self.name = str(group.name)

    def has(self, key: str) -> bool:
        return key in self.group

    def array(self, key: str, shape: Sequence[int | None]) -> FloatArray:
        values = np.asarray(self.raw(key))
        return float_array(
            f"{self.file_name}: {self.name}/{key}", values.reshape(-1) if len(shape) == 1 else values, shape
        )

    def number(self, key: str) -> float:
        return float(self.array(key, (1,))[0])

    def text(self, key: str) -> str:
        if key not in self.group:
            return ""
        value = np.asarray(self.raw(key)).reshape(-1)[0]
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)

    def raw(self, key: str) -> Any:
        if key not in self.group:
            raise InputError(f"{self.file_name}: {self.name} holds no '{key}' (it has: {', '.join(self.group)})")
        return self.group[key][()]

    def find(self, key: str) -> "_Node":
        """Return the node itself or the first group below it that holds the key (newer files nest some values)."""
        if key in self.group:
            return self
        for child in self.group.values():
            if isinstance(child, h5py.Group) and key in child:
                return _Node(self.file_name, child)
        raise InputError(f"{self.file_name}: {self.name} holds no '{key}' (it has: {', '.join(self.group)})")


def _hdf5_records(file_name: str, file: h5py.File) -> Iterator[Record]:
    for key, reader in _READERS.items():
        if key in file:
            yield reader(_Node(file_name, file[key]))
    # SOFAST keeps the definitions it worked with in its result files, one group for each facet.
    definitions = file.get("DataSofastInput/optic_definition")
    if isinstance(definitions, h5py.Group):
        yield from _definition_records(file_name, definitions)


def _definition_records(file_name: str, definitions: h5py.Group) -> Iterator[Record]:
    shapes = []
    for group in definitions.values():
        if "DefinitionFacet" in group:
            yield _facet(_Node(file_name, group["DefinitionFacet"]))
        if "DefinitionEnsemble" in group:
            yield _ensemble(_Node(file_name, group["DefinitionEnsemble"]))
        if "ParamsSurface" in group and "initial_focal_lengths_xy" in group["ParamsSurface"]:
            shapes.append(_Node(file_name, group["ParamsSurface"]).array("initial_focal_lengths_xy", (2,)))
    if "DefinitionEnsemble" in definitions:
        yield _ensemble(_Node(file_name, definitions["DefinitionEnsemble"]))
    if shapes:
        yield FocalLengthRecord(float(shapes[0][0]), float(shapes[0][1]))


def _fringes(node: _Node) -> FringeRecord:
    frames, masks = np.asarray(node.raw("fringe_images")), np.asarray(node.raw("mask_images"))
    if frames.ndim != 3 or masks.ndim != 3 or masks.shape != (*frames.shape[:2], 2):
        raise InputError(
            f"{node.file_name}: fringe_images of shape (h, w, n) and mask_images of shape (h, w, 2) are needed, not"
            f" {frames.shape} and {masks.shape}"
        )
    periods_y, periods_x = node.array("fringe_periods_y", (None,)), node.array("fringe_periods_x", (None,))
    needed = len(STEPS_DEG) * (periods_y.size + periods_x.size)
    if frames.shape[2] != needed:
        raise InputError(
            f"{node.file_name}: {frames.shape[2]} fringe frames, but {periods_y.size} periods in y and {periods_x.size}"
            f" in x with {len(STEPS_DEG)} steps each need {needed}"
        )
    where = node.find("dist_optic_screen")
    return FringeRecord(
        name=node.text("name"),
        date=node.text("date"),
        frames_dn=frames,
        dark_dn=masks[..., 0],
        bright_dn=masks[..., 1],
        periods_y=periods_y,
        periods_x=periods_x,
        distance_m=positive(f"{node.file_name}: dist_optic_screen", where.number("dist_optic_screen"), "metres"),
        measure_point_m=where.array("v_measure_point_facet", (3,)),
    )


def _dot_photo(node: _Node) -> DotPhotoRecord:
    photo = np.asarray(node.raw("image"))
    if photo.ndim != 2:
        raise InputError(f"{node.file_name}: image of shape (h, w) is needed, not {photo.shape}")
    where = node.find("dist_optic_screen")
    return DotPhotoRecord(
        name=node.text("name"),
        date=node.text("date"),
        photo_dn=photo,
        origin_px=node.array("origin", (None,)).reshape(2, -1).T,
        distance_m=positive(f"{node.file_name}: dist_optic_screen", where.number("dist_optic_screen"), "metres"),
        measure_point_m=where.array("v_measure_point_facet", (3,)),
    )


def _dot_table(node: _Node) -> DotTableRecord:
    column, row = node.array("x_dot_index", (None,)), node.array("y_dot_index", (None,))
    xyz = float_array(
        f"{node.file_name}: xyz_dot_loc", node.raw("xyz_dot_loc"), (row.size, column.size, 3), finite=False
    )
    known = np.isfinite(xyz).all(axis=2)
    columns, rows = np.meshgrid(column, row)
    return DotTableRecord(columns[known], rows[known], xyz[known])


def _camera(node: _Node) -> CameraRecord:
    matrix = np.array(node.array("intrinsic_mat", (3, 3)))
    # Down-sampled files hold the whole matrix divided by n: focal lengths and centre are as meant, the corner is not.
    averaged = 1 / positive(f"{node.file_name}: intrinsic_mat[2, 2]", float(matrix[2, 2]), "a camera matrix")
    matrix[2, 2] = 1.0
    coefficients = node.array("distortion_coef", (None,))
    if not 4 <= coefficients.size <= 5:
        raise InputError(
            f"{node.file_name}: distortion_coef of 4 or 5 numbers (k1, k2, p1, p2, k3) is needed,"
            f" not {coefficients.size}"
        )
    distortion = np.zeros(5)
    distortion[: coefficients.size] = coefficients
    shape = node.array("image_shape_xy", (2,))
    return CameraRecord(node.text("name"), (int(shape[0]), int(shape[1])), matrix, distortion, averaged)


def _display(node: _Node) -> RectangleRecord | TableRecord:
    model = node.text("screen_model")
    if model == "rectangular2D":
        width_m = positive(f"{node.file_name}: screen_x", node.number("screen_x"), "metres")
        return RectangleRecord(
            node.text("name"), width_m, positive(f"{node.file_name}: screen_y", node.number("screen_y"), "metres")
        )
    if model not in ("distorted2D", "distorted3D"):
        raise InputError(
            f"{node.file_name}: screen_model '{model}' is not known (rectangular2D, distorted2D, distorted3D are)"
        )
    fraction = node.array("xy_screen_fraction", (2, None))
    points = np.zeros((fraction.shape[1], 3))
    if model == "distorted2D":
        points[:, :2] = node.array("xy_screen_coords", (2, fraction.shape[1])).T
    else:
        points[:] = node.array("xyz_screen_coords", (3, fraction.shape[1])).T
    return TableRecord(node.text("name"), fraction[0], 1 - fraction[1], points)


def _orientation(node: _Node) -> RigidTransform:
    return _pose(node.array("r_cam_screen", (3,)), node.array("v_cam_screen_cam", (3,)))


def _pose(other_from_cam_rad: FloatArray, origin_in_cam_m: FloatArray) -> RigidTransform:
    """Return ``cam_from_other``: the files hold the rotation camera -> other, but the origin seen from the camera."""
    return RigidTransform.from_rotation_vector(-other_from_cam_rad, origin_in_cam_m)


def _response(node: _Node) -> ResponseRecord:
    camera = node.array("camera_values", (None,))
    return ResponseRecord(camera, node.array("display_values", (camera.size,)))


def _facet(node: _Node) -> FacetRecord:
    return FacetRecord(node.array("v_facet_corners", (3, None)).T, node.array("v_facet_centroid", (3,)))


def _ensemble(node: _Node) -> EnsembleRecord:
    origins = node.array("v_facet_locations", (3, None)).T
    vectors = node.array("r_facet_ensemble", (origins.shape[0], 3))
    return EnsembleRecord(_placements(vectors, origins), node.array("v_centroid_ensemble", (3,)))


def _placements(vectors: FloatArray, origins: FloatArray) -> tuple[RigidTransform, ...]:
    return tuple(RigidTransform.from_rotation_vector(r, t) for r, t in zip(vectors, origins, strict=True))


def _calculation(node: _Node) -> CalculationRecord:
    facets = [_Node(node.file_name, group) for group in node.group["facet"].values()] if node.has("facet") else []
    if not facets:
        raise InputError(f"{node.file_name}: {node.name} holds no facet")
    solved = [_Node(node.file_name, facet.group["SlopeSolverData"]) for facet in facets if facet.has("SlopeSolverData")]
    return CalculationRecord(
        cam_from_mirror=_facet_pose(facets[0]) if len(facets) == 1 else _last_refined_pose(node),
        surface_points_m=tuple(data.array("v_surf_points_facet", (3, None)) for data in solved),
        slopes=tuple(data.array("slopes_facet_xy", (2, None)) for data in solved),
    )


def _facet_pose(facet: _Node) -> RigidTransform | None:
    path = "CalculationDataGeometryFacet/SpatialOrientation"
    if not facet.has(path):
        return None
    orientation = _Node(facet.file_name, facet.group[path])
    return _pose(orientation.array("r_cam_optic", (3,)), orientation.array("v_cam_optic_cam", (3,)))


def _last_refined_pose(node: _Node) -> RigidTransform:
    """Return the pose of an ensemble: SOFAST numbers its refinements, the last one counts."""
    path = "general/CalculationDataGeometryGeneral"
    general = _Node(node.file_name, node.group[path]) if node.has(path) else node
    keys: list[str] = []
    for prefix in ("r_optic_cam_refine_", "v_cam_optic_cam_refine_"):
        found = sorted(key for key in general.group if key.startswith(prefix))
        if not found:
            raise InputError(f"{node.file_name}: {general.name} holds no {prefix}*, so no pose of the mirror")
        keys.append(found[-1])
    return _pose(-general.array(keys[0], (3,)), general.array(keys[1], (3,)))


_READERS: dict[str, Callable[[_Node], Record]] = {
    "MeasurementSofastFringe": _fringes,
    "MeasurementSofastFixed": _dot_photo,
    "DotLocationsFixedPattern": _dot_table,
    "Camera": _camera,
    "DisplayShape": _display,
    "SpatialOrientation": _orientation,
    "ImageCalibration": _response,
    "DataSofastCalculation": _calculation,
    "DefinitionFacet": _facet,
    "DefinitionEnsemble": _ensemble,
}


def _json_records(path: Path) -> Iterator[Record]:
    try:
        content = read_json(path)
    except InputError as error:
        raise InputError(f"{error} (it is no HDF5 file either)") from error
    if not isinstance(content, dict):
        return
    try:
        if "v_facet_corners" in content:
            # Some versions call the centroid v_centroid_facet, some v_facet_centroid.
            centroid = content.get("v_centroid_facet", content.get("v_facet_centroid"))
            yield FacetRecord(_vectors(path, content["v_facet_corners"]), _vectors(path, centroid)[0])
        if "v_facet_locations" in content:
            rotations = content["r_facet_ensemble"]
            vectors = float_array(
                f"{path.name}: r_facet_ensemble", [rotations[key] for key in sorted(rotations, key=int)], (None, 3)
            )
            origins = _vectors(path, content["v_facet_locations"])
            if len(vectors) != len(origins):
                raise InputError(f"{path.name}: {len(origins)} facet locations, but {len(vectors)} facet rotations")
            yield EnsembleRecord(_placements(vectors, origins), _vectors(path, content["v_centroid_ensemble"])[0])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        message = f"{path.name}: a facet or ensemble definition, but a part is missing or wrong ({error!r})"
        raise InputError(message) from error


def _vectors(path: Path, axes: Any) -> FloatArray:
    return float_array(f"{path.name}: x, y, z", np.column_stack([axes["x"], axes["y"], axes["z"]]), (None, 3))
