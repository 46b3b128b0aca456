"""From a calibration to the photos to take next: read its folder, choose, write them and what they will be worth."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from calibration.camera.files.findings import sigma_of_shape
from calibration.camera.files.result import Result, open_calibration
from calibration.camera.judgement.projection_sigma import sigma_map
from calibration.camera.planning.candidate_views import Lengths, nearer_side, place_words
from calibration.camera.planning.next_photos import Expectation, NextPhoto, adjusted_again, choose_photos
from calibration.camera.report.planned_pictures import board_pictures
from calibration.camera.start_values.intrinsics import tilt_and_roll
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.files.faults import explain_faults
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.writer import write_text
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    Summary,
    hash_files,
    read_summary,
    write_cameras_json,
    write_points_csv,
    write_table_csv,
)
from heliogauge.results.frame import InstrumentResult
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import FloatArray, positive

#: A photo that makes the sigma smaller by less than this adds no more than any other does.
_LITTLE_SHARE = 0.05
#: The camera may be nearer or farther than it was by this factor, the depth a calibration is asked for.
_REACH = 1.5
#: A settled adjustment moves by less than a tenth of a sigma when it is done again.
_SAME_SIGMAS = 0.5
_FILES = ("cameras.json", "points.csv", "board.csv", "common_errors.csv", "image_points.csv", "photos.csv")
_INTRINSIC_KEYS = {name: f"{name}_factor" for name in ("k1", "k2", "k3", "p1", "p2", "skew")} | {
    "aspect": "aspect_ratio"
}


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """What is wanted of the next photos.

    Parameters
    ----------
    photos : int
        How many at most.
    wanted_rad : float or None
        Sigma of lines of sight, best rotation taken out, that is enough [rad].
    parameters : tuple of str
        Intrinsics whose sigmas shall become small; none: lines of sight.
    nearest, farthest : float or None
        Distances of the camera that are possible, in the unit of photos.csv; default: half as near and half as far
        again as the photos so far.
    """

    photos: int = 4
    wanted_rad: float | None = None
    parameters: tuple[str, ...] = ()
    nearest: float | None = None
    farthest: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class NextPhotosResult(InstrumentResult):
    """A plan, ready to be written.

    calibration: What the plan starts from.
    today: Its expectation as it is.
    photos: The photos to take, in their order.
    options: What was asked.
    """

    kind: ClassVar[str] = "camera-plan"
    calibration: Result
    today: Expectation
    photos: tuple[NextPhoto, ...]
    options: PlanOptions

    def summarise(self) -> Summary:
        """Collect the headline numbers of a plan."""
        before, after = self.today.camera, self.photos[-1].expected.camera
        numbers: dict[str, float | int | None] = {
            "photos_count": len(self.photos),
            "earlier_photos_count": len(self.calibration.photos),
            "sigma_ray_without_rotation_rms_rad": sigma_map(before).rms_free_rad,
            "planned_sigma_ray_without_rotation_rms_rad": sigma_map(after).rms_free_rad,
            "wanted_sigma_ray_without_rotation_rms_rad": self.options.wanted_rad,
        }
        if self.options.wanted_rad is None:
            del numbers["wanted_sigma_ray_without_rotation_rms_rad"]
        for name, own, planned in zip(self._free, self._sigmas(self.today), self._sigmas(self._last), strict=True):
            key = _INTRINSIC_KEYS.get(name, name)
            numbers |= {f"sigma_{key}": own, f"planned_sigma_{key}": planned}
        unit = _unit(self.calibration)
        texts = {
            "answer": f"{len(self.photos)} photos more",
            "made_small": ", ".join(self.options.parameters) or "sigma of lines of sight, best rotation taken out",
            "unit": "metres" if unit == "m" else "pitches of the board",
            "sigma": "1 standard deviation; sizes of what corners have in common as the photos so far give them, "
            "and how well the new ones will tell them, averaged over draws of their points",
            "not_included": "depth of field and light: whether the board can be seen sharply from there",
        }
        return self._summary(numbers, texts)

    @property
    def _last(self) -> Expectation:
        return self.photos[-1].expected

    @property
    def _free(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.calibration.intrinsics)

    def _sigmas(self, expected: Expectation) -> list[float]:
        return [float(value) for value in np.sqrt(np.diag(expected.covariance_intrinsics))]

    def write_files(self, folder: Path) -> None:
        """Write photos to take, their picture, the camera and the board as they will be known."""
        calibration, mixed = self.calibration, self._last.draws[0]
        unit = _unit(calibration)
        write_table_csv(folder / "next_photos.csv", self.columns())
        outlines = [outline_px(self.today.camera, calibration, one.cam_from_board) for one in self.photos]
        points = [_points_px(self.today.camera, calibration, one.cam_from_board) for one in self.photos]
        table = {"photo": [one.name for one in self.photos for _ in range(4)]}
        corners = np.concatenate(outlines)
        write_table_csv(folder / "outlines.csv", {**table, "x_px": corners[:, 0], "y_px": corners[:, 1]})
        words = [(one.name, str(what)) for one, what in zip(self.photos, self.columns()["what"], strict=True)]
        write_text(folder / "next_photos.svg", board_pictures(self.today.camera, outlines, points, words).svg())
        first = len(calibration.photos)
        poses = {
            one.name: PhotoPose(calibration.camera_name, one.cam_from_board, mixed.covariance_poses[first + i])
            for i, one in enumerate(self.photos)
        }
        write_cameras_json(folder / "cameras.json", {calibration.camera_name: self._last.camera}, poses, unit)
        shape = calibration.shape
        names = tuple(shape.board.names[i] for i in shape.seen)
        sigma = sigma_of_shape(mixed.state.points_m, mixed.covariance_points_m2)
        rays = np.full(len(names), len(self.photos), dtype=np.int64) + shape.n_rays.astype(np.int64)
        flags = np.zeros(len(names), dtype=np.uint32)
        write_points_csv(folder / "points.csv", PointTable(names, shape.points_m, sigma, rays, flags), unit)

    def columns(self) -> dict[str, Any]:
        """Return the photos to take as a table."""
        calibration, camera = self.calibration, self.today.camera
        poses = [one.cam_from_board for one in self.photos]
        outlines = [outline_px(camera, calibration, pose) for pose in poses]
        angles = np.degrees([tilt_and_roll(pose) for pose in poses])
        centers = np.array([0.5 * (one.min(axis=0) + one.max(axis=0)) for one in outlines])
        sides, places = [nearer_side(pose) for pose in poses], [place_words(camera, one) for one in outlines]
        distances = [float(np.linalg.norm(pose.translation_m)) for pose in poses]
        what = [
            f"{_roll_words(roll)}, "
            + (f"{side} side nearer, tilted by {tilt:.0f} deg" if side else "seen straight on")
            + f", in the {place} of the image"
            for roll, tilt, side, place in zip(angles[:, 1], angles[:, 0], sides, places, strict=True)
        ]
        sigmas = np.array([self._sigmas(one.expected) for one in self.photos])
        return {
            "photo": [one.name for one in self.photos],
            "what": what,
            "roll_deg": angles[:, 1].tolist(),
            "tilt_deg": angles[:, 0].tolist(),
            "nearer_side": sides,
            "place": places,
            f"distance_{_unit(calibration)}": distances,
            "center_x_px": centers[:, 0],
            "center_y_px": centers[:, 1],
            "width_px": [float(np.ptp(one[:, 0])) for one in outlines],
            "height_px": [float(np.ptp(one[:, 1])) for one in outlines],
            "sigma_ray_without_rotation_rms_rad": [sigma_map(one.expected.camera).rms_free_rad for one in self.photos],
            **{f"sigma_{name}": sigmas[:, i] for i, name in enumerate(self._free)},
        }

    def headline(self) -> str:
        """Return the plan in a few lines for the terminal."""
        columns, unit = self.columns(), "m" if _unit(self.calibration) == "m" else "pitches"
        before = sigma_map(self.today.camera).rms_free_rad
        lines = [
            f"{self.name}: photos to take next",
            f"  today            +- {1e3 * before:.2g} mrad rms line of sight, {len(self.calibration.photos)} photos",
        ]
        sigmas = columns["sigma_ray_without_rotation_rms_rad"]
        distances = columns[f"distance_{_unit(self.calibration)}"]
        for name, what, distance, sigma in zip(columns["photo"], columns["what"], distances, sigmas, strict=True):
            lines += [
                f"  {name}          {what}, from {distance:.3g} {unit}",
                f"  {'':16} +- {1e3 * sigma:.2g} mrad with it",
            ]
        for name in self.options.parameters:
            i = self._free.index(name)
            both = self._sigmas(self.today)[i], self._sigmas(self._last)[i]
            lines.append(f"  {name:16} +- {both[0]:.2g} today, +- {both[1]:.2g} with all of them")
        lines.append("  how it looks     next_photos.svg; all numbers: next_photos.csv")
        return "\n".join(lines)


def run(folder: Path, options: PlanOptions | None = None, progress: Progress | None = None) -> NextPhotosResult:
    """Choose the photos that a calibration needs next.

    folder: Results of `heliogauge camera measure`, or the cameras.json in them.
    InputError: No such results, unknown intrinsics, or impossible wishes.
    EstimationError: No view of the whole board can be taken.
    """
    options, progress = options or PlanOptions(), progress or SilentProgress()
    folder = folder.parent if folder.name == "cameras.json" else folder
    with progress.stage("read the calibration"):
        if (folder / "summary.json").is_file() and (kind := read_summary(folder / "summary.json").kind) != Result.kind:
            raise InputError(f"{folder}: results of kind {kind!r}; those of `heliogauge camera measure` are needed")
        hashes = hash_files([folder / name for name in _FILES], folder)
        with explain_faults(folder, "a folder of results as `heliogauge camera measure` writes it"):
            calibration = open_calibration(folder)
            today = Expectation((adjusted_again(calibration),))
            _check_same(calibration, today)
    lengths = _lengths(calibration, options)
    with progress.stage("choose photos", options.photos) as stage:
        photos = choose_photos(
            today,
            lengths,
            options.parameters,
            options.photos,
            wanted_rad=options.wanted_rad or 0.0,
            tell=stage.advance,
        )
    return NextPhotosResult(
        name=calibration.name,
        calibration=calibration,
        today=today,
        photos=tuple(photos),
        options=options,
        doubts=tuple(_doubts(today, photos, options)),
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _check_same(calibration: Result, today: Expectation) -> None:
    """Refuse files that do not hold one calibration: the camera they give anew is not the one that is stated."""
    stated, again = calibration.camera.parameters, today.camera.parameters
    sigma = calibration.camera.sigma_parameters
    off = np.abs(again - stated)[sigma > 0] / sigma[sigma > 0]
    if not (off < _SAME_SIGMAS).all():
        raise InputError(
            f"plan: points.csv, image_points.csv and common_errors.csv give a camera {off.max():.2g} sigmas off "
            "cameras.json: they are not of one calibration: calibrate again"
        )


def _lengths(calibration: Result, options: PlanOptions) -> Lengths:
    """Check what is wanted, and return what limits the next photos."""
    if options.photos < 1:
        raise InputError(f"photos={options.photos}: at least one photo is to be planned")
    if options.wanted_rad is not None:
        positive("wanted_rad", options.wanted_rad, "radians")
    free = [one.name for one in calibration.intrinsics]
    strangers = [name for name in options.parameters if name not in free]
    if strangers:
        raise InputError(f"parameter {strangers[0]!r}: not estimated in this calibration; one of {', '.join(free)}")
    shape = calibration.shape
    drawn = shape.points_m
    spread = np.linalg.svd(drawn - drawn.mean(axis=0), compute_uv=False)
    normal = np.linalg.svd(drawn - drawn.mean(axis=0))[2][2]
    if spread[2] > spread[1] or abs(normal[2]) < np.cos(np.radians(30)):
        raise InputError(
            "plan: the targets are not on a board seen from z: photos are proposed for boards and plates; for targets "
            "all around, turn the camera by 90 degrees at each place"
        )
    distances = [float(np.linalg.norm(photo.cam_from_board.translation_m)) for photo in calibration.photos]
    nearest = min(distances) / _REACH if options.nearest is None else options.nearest
    farthest = max(distances) * _REACH if options.farthest is None else options.farthest
    if not 0 < nearest < farthest:
        raise InputError(f"nearest={nearest:g}, farthest={farthest:g}: positive distances in this order are needed")
    return Lengths(shape.points_m, shape.board.pitch_m, nearest, farthest)


def _doubts(today: Expectation, photos: list[NextPhoto], options: PlanOptions) -> list[Doubt]:
    found = []
    sigmas = [sigma_map(today.camera).rms_free_rad, *(sigma_map(one.expected.camera).rms_free_rad for one in photos)]
    if options.wanted_rad is not None and sigmas[-1] > options.wanted_rad:
        text = (
            f"the wanted sigma of {1e3 * options.wanted_rad:.2g} mrad is not reached with {len(photos)} photos more: "
            f"{1e3 * sigmas[-1]:.2g} mrad; plan more (--photos), or calibrate with these and plan again"
        )
        numbers = {"wanted_rad": options.wanted_rad, "reached_rad": sigmas[-1], "photos_count": len(photos)}
        found.append(Doubt("plan_sigma_not_reached", text, numbers, Severity.SERIOUS))
    if not options.parameters and sigmas[1] > (1 - _LITTLE_SHARE) * sigmas[0]:
        text = (
            f"the best photo makes the sigma of lines of sight smaller by {1 - sigmas[1] / sigmas[0]:.1%} only: the "
            "photos so far have what a calibration needs; many more, or a flatter board, would be needed for less"
        )
        found.append(Doubt("plan_adds_little", text, {"gain_share": 1 - sigmas[1] / sigmas[0]}, Severity.NOTE))
    return found


def outline_px(camera: Camera, calibration: Result, pose: RigidTransform) -> FloatArray:
    """Return the corners of the board in a photo, upper left of its drawing first, clockwise, shape (4, 2) [px]."""
    lengths = Lengths(calibration.shape.points_m, calibration.shape.board.pitch_m, 0.0, np.inf)
    return camera.project(pose.apply(lengths.outline_m))


def _points_px(camera: Camera, calibration: Result, pose: RigidTransform) -> FloatArray:
    return camera.project(pose.apply(calibration.shape.points_m))


def _unit(calibration: Result) -> str:
    return "m" if calibration.shape.board.is_metric else "pitch"


def _roll_words(roll_deg: float) -> str:
    """Say how the camera is turned: where the rows of the board run in the image."""
    turn: Mapping[int, str] = {0: "to the right", 1: "downwards", 2: "to the left", 3: "upwards"}
    return f"rows run {turn[round(roll_deg / 90) % 4]} (roll {roll_deg:.0f} deg)"
