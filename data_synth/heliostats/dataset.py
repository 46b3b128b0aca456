"""Measurement folders of heliostats with known truth: measurement.toml, tables, photos, truth.json, truth.npz."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from calibration.heliostat.kinematic_model import PlaneTarget
from data_synth.fringes.dataset import SYNTHETIC, TRUTH_ARRAYS_FILE, TRUTH_FILE
from data_synth.fringes.truth import TRUTH_SCHEMA
from data_synth.heliostats.campaign import Beams, Campaign, observe
from data_synth.heliostats.drone import Sightings, fly, rtk_log
from data_synth.heliostats.faults import Columns, Unit, spoil_rows
from data_synth.heliostats.flux import Beam, Facets, beam_on_target, canted_facets
from data_synth.heliostats.photo import TargetCamera, TargetSurface, look_at
from data_synth.heliostats.presets import FREE_SETS, HeliostatScene, PhotoPlan
from heliogauge.camera.distortion import BrownDistortion
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.files.arrays import read_arrays
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.sun import angles_from_direction
from heliogauge.images.photos import write_image
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.measurement.writer import dump_toml, write_text
from heliogauge.results.json_file import read_json, write_json
from heliogauge.results.tables import table_lines, write_camera_json, write_table_csv
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import BoolArray, FloatArray, IntArray

_Array: TypeAlias = npt.NDArray[Any]
HELIOSTATS_FILE, OBSERVATIONS_FILE = "heliostats.csv", "observations.csv"
CAMERA_FILE = "camera.json"
#: Log of the drone's receiver at rest.
RTK_FILE = "rtk_static.csv"
_SOURCE_ROW = "source_row"
#: Arrays of truth.npz: one entry for each row of observations.csv.
_ARRAYS = ("heliostat", "spot_m", "normal", "outlier")


@dataclass(frozen=True, slots=True)
class HeliostatOptions:
    """How a scene becomes a folder.

    seed: Seed of all noise; the same seed gives the same files.
    force: Replace an earlier synthetic measurement.
    """

    seed: int = 0
    force: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class HeliostatTruth(ShortRepr):
    """Truth of a synthetic measurement of heliostats; arrays have one entry for each row of observations.csv.

    parameters: The content of truth.json: site, targets, and of each heliostat its true numbers and its faults.
    heliostat (n,): Index into the list of heliostats.
    spot_m (n, 2): Where the beam's middle ray met its target: right, up from the centre; NaN for other observations
        [m].
    normal (n, 3): True normal of the mirror.
    outlier (n,): Rows whose spot was spoiled.
    """

    parameters: Mapping[str, Any]
    heliostat: IntArray
    spot_m: FloatArray
    normal: FloatArray
    outlier: BoolArray

    def values(self, heliostat: str) -> dict[str, float]:
        """Return the true numbers of a heliostat, by its name."""
        known = {one["heliostat"]: one["values"] for one in self.parameters["heliostats"]}
        if heliostat not in known:
            raise InputError(f"truth.json: there is no heliostat {heliostat!r}")
        return dict(known[heliostat])


def write_heliostat_dataset(
    folder: Path, scene: HeliostatScene, options: HeliostatOptions | None = None, progress: Progress | None = None
) -> None:
    """Measure a scene's heliostats and write a measurement folder that is whole or not there.

    folder: Where to write; must be absent or empty.
    InputError: The folder holds something, cannot be written to, or the scene cannot be measured.
    """
    chosen = HeliostatOptions() if options is None else options
    progress = SilentProgress() if progress is None else progress
    rngs = np.random.default_rng([chosen.seed, 7]).spawn(len(scene.units) + 1)
    with WholeFolder(folder, SYNTHETIC, force=chosen.force) as working:
        photographer = None if scene.photos is None else _Photographer(working, scene, scene.photos, rngs[-1])
        campaign = scene.campaign
        arrays, records = [], []
        # Rows go out as they come: ten thousand heliostats of a hundred beams would fill a gigabyte.
        with (
            _table(working / OBSERVATIONS_FILE) as add,
            progress.stage("measure heliostats", len(scene.units)) as stage,
        ):
            for index, (unit, rng) in enumerate(zip(scene.units, rngs, strict=False)):
                columns, truth, record = _measured(scene, unit, rng, campaign, photographer)
                add(columns)
                arrays.append({**truth, "heliostat": np.full(len(truth["normal"]), index)})
                records.append(record)
                stage.advance()
        with progress.stage("write tables"):
            write_table_csv(working / HELIOSTATS_FILE, _heliostats(scene))
            if scene.photos is not None and scene.photos.is_distorted:
                write_camera_json(working / CAMERA_FILE, _camera(scene.photos))
            if scene.flight is not None:
                write_table_csv(working / RTK_FILE, rtk_log(scene.units[0].disturbances.rtk_m, rngs[-1]))
            corners = {} if photographer is None else photographer.stated()
            content = heliostat_content(scene, corners)
            comment = f"Synthetic measurement, seed {chosen.seed}; see {TRUTH_FILE}."
            write_text(working / MEASUREMENT_FILE, f"# {comment}\n\n" + dump_toml(content))
            cameras = [] if photographer is None else photographer.to_json()
            write_json(
                working / TRUTH_FILE,
                {**scene_to_json(scene), "seed": chosen.seed, "heliostats": records, "cameras": cameras},
            )
            stacked = {name: np.concatenate([one[name] for one in arrays]) for name in _ARRAYS}
            np.savez_compressed(working / TRUTH_ARRAYS_FILE, **stacked)  # type: ignore[arg-type]


def read_heliostat_truth(folder: Path) -> HeliostatTruth:
    """Read the truth of a synthetic measurement of heliostats."""
    parameters = read_json(folder / TRUTH_FILE)
    file = folder / TRUTH_ARRAYS_FILE
    return HeliostatTruth(parameters, *read_arrays(file, _ARRAYS).values())


def heliostat_content(scene: HeliostatScene, corners_px: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Return what measurement.toml says.

    corners_px (4, 2): Corners of the targets in the photos of beams, as a person measured them [px].
    """
    site = scene.plant.site
    kinematics: dict[str, Any] = {"preset": scene.kind, "free": FREE_SETS[scene.kind]}
    if scene.counts_per_turn is not None:
        kinematics["counts_per_turn"] = list(scene.counts_per_turn)
    if scene.priors:
        kinematics["parameters"] = {name: {"sigma": sigma} for name, sigma in scene.priors.items()}
    content: dict[str, Any] = {
        "kind": "heliostat",
        "name": scene.name,
        "notes": "Synthetic: made by heliogauge heliostat synth.",
        "site": {
            "latitude_deg": site.latitude_deg,
            "longitude_deg": site.longitude_deg,
            "altitude_m": site.altitude_m,
        },
        "target": [_target_to_json(target) for target in scene.plant.targets],
        "heliostats": {"file": HELIOSTATS_FILE},
        "kinematics": kinematics,
        "observations": {"file": OBSERVATIONS_FILE},
    }
    if corners_px and scene.photos is not None:
        lens = {"camera": CAMERA_FILE} if scene.photos.is_distorted else {}
        content["images"] = [
            {
                "target": name,
                "corners_px": corners.round(2).tolist(),
                "corners_sigma_px": scene.photos.corner_sigma_px,
                "empty": f"{_folder(name)}/empty_*.png",
                **lens,
            }
            for name, corners in corners_px.items()
        ]
    return content


def scene_to_json(scene: HeliostatScene) -> dict[str, Any]:
    """Return what all heliostats of a scene share, as plain values for truth.json."""
    return {
        "schema": TRUTH_SCHEMA,
        "kind": "heliostat",
        "name": scene.name,
        "site": asdict(scene.plant.site),
        "targets": [_target_to_json(target) for target in scene.plant.targets],
        "kinematics": scene.kind,
        "reading_unit": scene.reading_unit,
        "days": list(scene.schedule.days),
    }


def _target_to_json(target: PlaneTarget) -> dict[str, Any]:
    azimuth = float(np.degrees(np.arctan2(target.normal[0], target.normal[1]))) % 360
    return {
        "name": target.name,
        "center_m": target.center_m.tolist(),
        "width_m": target.width_m,
        "height_m": target.height_m,
        "facing_azimuth_deg": round(azimuth, 9) + 0.0,
    }


class _UnitData(NamedTuple):
    """What is written of one heliostat: rows of observations.csv, true values of each row, record of its errors."""

    columns: Columns
    truth: dict[str, _Array]
    record: dict[str, Any]


def _measured(
    scene: HeliostatScene,
    unit: Unit,
    rng: np.random.Generator,
    campaign: Campaign | None,
    photographer: "_Photographer | None",
) -> _UnitData:
    measuring, spoiling = rng.spawn(2)
    truth: dict[str, _Array]
    if campaign is None:
        columns, truth = _flown(scene, unit, measuring)
    else:
        beams = observe(unit.true, scene.plant, campaign, unit.disturbances, measuring, changes=unit.changes)
        columns = beams.rows(scene.plant.targets, scene.reading_unit)
        truth = {"spot_m": beams.spot_m, "normal": beams.poses.normals, "outlier": beams.outlier}
        if scene.states_sun:
            columns |= _sun_columns(beams)
        if photographer is not None:
            columns |= photographer.take(unit.true.name, beams)
    columns[_SOURCE_ROW] = list(range(len(truth["normal"])))
    targets = tuple(target.name for target in scene.plant.targets)
    columns, touched = spoil_rows(columns, unit.faults, targets, spoiling)
    source = columns.pop(_SOURCE_ROW)
    truth = {name: values[source] for name, values in truth.items()}
    record = {
        "heliostat": unit.true.name,
        "values": dict(unit.true.values),
        "stated": dict(unit.stated),
        "drives": [asdict(flaw) for flaw in unit.true.flaws],
        "disturbances": asdict(unit.disturbances),
        "jumps": dict(unit.changes.jumps),
        "jump_date": unit.changes.date,
        "per_year": dict(unit.changes.per_year),
        "faults": [{"fault": fault, "rows": touched.get(fault)} for fault in unit.faults],
    }
    return _UnitData({"heliostat": [unit.true.name] * len(source), **columns}, truth, record)


def _flown(scene: HeliostatScene, unit: Unit, rng: np.random.Generator) -> tuple[Columns, dict[str, _Array]]:
    if scene.flight is None:
        raise InputError("this scene has no flight")
    places, noise = rng.spawn(2)
    target = scene.plant.targets[0]
    sightings: Sightings = fly(unit.true, target, scene.flight, unit.disturbances.rtk_m, (places, noise))
    columns = sightings.rows(target, scene.reading_unit, unit.disturbances.rtk_m)
    count = len(sightings)
    none = np.full((count, 2), np.nan)
    return columns, {"spot_m": none, "normal": sightings.poses.normals, "outlier": np.zeros(count, dtype=np.bool_)}


def _camera(plan: PhotoPlan) -> Camera:
    lens = plan.camera
    return Camera(
        lens.width_px,
        lens.height_px,
        lens.focal_x_px,
        lens.focal_y_px,
        lens.center_x_px,
        lens.center_y_px,
        distortion=BrownDistortion(lens.k1, lens.k2, lens.k3, lens.p1, lens.p2),
    )


def _sun_columns(beams: Beams) -> Columns:
    azimuth, elevation = angles_from_direction(beams.sun)
    return {
        "sun_azimuth_deg": np.degrees(azimuth).round(6).tolist(),
        "sun_elevation_deg": np.degrees(elevation).round(6).tolist(),
    }


@contextmanager
def _table(path: Path) -> Iterator[Callable[[Columns], None]]:
    """Open a table to which columns of further rows are added; the first ones name all of them."""
    with path.open("w", encoding="utf-8", newline="") as file:
        header: list[str] = []

        def add(columns: Columns) -> None:
            is_first = not header
            if is_first:
                header.extend(columns)
            lines = table_lines(path.name, {name: columns[name] for name in header})
            file.writelines(lines if is_first else islice(lines, 1, None))

        yield add


def _heliostats(scene: HeliostatScene) -> Columns:
    position = ("position_e", "position_n", "position_u")
    columns: Columns = {"heliostat": [unit.true.name for unit in scene.units]}
    for name, column in zip(position, ("e_m", "n_m", "u_m"), strict=True):
        columns[column] = [round(float(unit.stated[name]), 6) for unit in scene.units]
    for name in scene.units[0].stated:
        if name not in position and any(unit.stated[name] for unit in scene.units):
            columns[name] = [float(unit.stated[name]) for unit in scene.units]
    return columns


def _folder(target: str) -> str:
    return "photos_" + "".join(letter if letter.isalnum() else "_" for letter in target)


class _Photographer:
    """Takes photos of beams with one camera for each target, and of the empty targets."""

    def __init__(self, folder: Path, scene: HeliostatScene, plan: PhotoPlan, rng: np.random.Generator) -> None:
        self.folder, self.plan, self.rng = folder, plan, rng
        self.targets = scene.plant.targets
        self.cameras = []
        for target in self.targets:
            place = np.array(plan.place_m)
            pose = look_at(place, target.center_m + [0.2, 0.0, -0.15], 0.015)
            surface = TargetSurface(target.width_m, target.height_m)
            self.cameras.append(TargetCamera(plan.camera, pose, target, surface, plan.sensor, plan.light))
            (folder / _folder(target.name)).mkdir()
        self.mirrors: dict[str, Facets] = {}
        self.truth: list[dict[str, Any]] = []
        for target, camera in zip(self.targets, self.cameras, strict=True):
            for number in range(plan.empty):
                photo = camera.take(None, rng, self._ambient())
                write_image(folder / _folder(target.name) / f"empty_{number:02d}.png", photo)

    def take(self, name: str, beams: Beams) -> Columns:
        """Take a photo of each beam of a heliostat; its spots are then not in the table."""
        files = []
        for row in range(len(beams)):
            index = int(beams.target[row])
            target = self.targets[index]
            center = beams.poses.center_m[row]
            if name not in self.mirrors:
                distance = float(np.linalg.norm(target.center_m - center))
                self.mirrors[name] = canted_facets((2, 2), self.plan.mirror_m, distance, self.plan.facets, self.rng)
            pose = RigidTransform(beams.poses.rotation[row], center)
            beam = beam_on_target(self.mirrors[name], pose, beams.sun[row], target)
            file = f"{_folder(target.name)}/{name}_{row:04d}.png"
            write_image(self.folder / file, self.cameras[index].take(beam, self.rng, self._ambient()))
            self.truth.append(_photo_to_json(file, beam, target))
            files.append(file)
        empty = [np.nan] * len(files)
        return {"x_m": empty, "y_m": empty, "sigma_x_mm": empty, "sigma_y_mm": empty, "image": files}

    def stated(self) -> dict[str, FloatArray]:
        """Return the corners of the targets in the photos as a person measures them."""
        return {
            target.name: camera.image_points(camera.surface.corners_m)
            + self.plan.corner_sigma_px * self.rng.standard_normal((4, 2))
            for target, camera in zip(self.targets, self.cameras, strict=True)
        }

    def to_json(self) -> list[dict[str, Any]]:
        """Return the cameras, the true corners, marks, and the beams of all photos, for truth.json."""
        cameras = []
        for target, camera in zip(self.targets, self.cameras, strict=True):
            cameras.append(
                {
                    "target": target.name,
                    "camera": asdict(self.plan.camera),
                    "cam_from_world": {
                        "rotation_vector_rad": camera.cam_from_world.rotation_vector_rad.tolist(),
                        "translation_m": camera.cam_from_world.translation_m.tolist(),
                    },
                    "corners_px": camera.image_points(camera.surface.corners_m).tolist(),
                    "marks_m": camera.surface.marks_m.tolist(),
                    "marks_px": camera.image_points(camera.surface.marks_m).tolist(),
                    "photos": [photo for photo in self.truth if photo["target"] == target.name],
                }
            )
        return cameras

    def _ambient(self) -> float:
        # Thin clouds and the sun's height: a tenth either way, and never negative.
        return float(np.exp(0.08 * self.rng.standard_normal()))


def _photo_to_json(file: str, beam: Beam, target: PlaneTarget) -> dict[str, Any]:
    return {
        "file": file,
        "target": target.name,
        "centroid_m": beam.centroid_m.tolist(),
        "power_m2": beam.power_m2,
        "peak_suns": float(beam.suns.max()),
        "share_on_target": beam.share_inside(target.width_m, target.height_m),
    }


def iterate_photos(truth: HeliostatTruth) -> Iterator[Mapping[str, Any]]:
    """Yield the beam of each photo as truth.json has it: file, target, centroid_m, power_m2, share_on_target."""
    for camera in truth.parameters["cameras"]:
        yield from camera["photos"]
