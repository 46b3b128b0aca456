"""What a measurement gave: its files, its summary, its lines on the terminal."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from deflectometry.pipeline.evaluate import Evaluation
from deflectometry.pipeline.headline import Numbers, flag_words, geometry, headline_text, reasons
from deflectometry.pipeline.stated_inputs import INPUTS_FILE, StatedInput, inputs_table
from deflectometry.pose.adjust_pose import MirrorPose
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.facet_canting import CANTING_FILE, CANTING_SIGN, MOUNTS_FILE, FacetCanting
from deflectometry.shape.pixel_slopes import bounding_box
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import skew
from heliogauge.results.folder import (
    CutOut,
    PhotoPose,
    Summary,
    write_cameras_json,
    write_pixels,
    write_slope_map,
    write_table_csv,
)
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import ASSEMBLED
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """Everything a measurement gave, ready to be written.

    Parameters
    ----------
    setup : Setup
        Camera and screen as used.
    pattern : str
        What was shown, in words.
    evaluation : Evaluation
        Poses, pixels and the map of each facet as measured.
    maps : dict of str to SlopeMap
        The map of each measured facet, after what was to be removed.
    assembled : SlopeMap
        The map of the whole mirror, put together from these; that of the only facet where there is one.
    assembled_as_measured : SlopeMap
        The same before anything was removed.
    numbers : dict of str to number
        Headline numbers of the mirror.
    facets : dict of str to dict
        Headline numbers of each facet; empty for a single one.
    cantings : tuple of FacetCanting
        Canting of each facet of an ensemble with the moves of its mounts; empty for a single facet.
    inputs : tuple of StatedInput
        What measurement.toml states, and how much the result rests on each.
    texts : dict of str to str
        What else is said of the result, by what it is about.
    name : str
        Name of the mirror.
    doubts : tuple of Doubt
        What makes the result doubtful.
    durations_s : dict of str to float
        Wall time of each stage [s].
    input_sha256 : dict of str to str
        Hash of each file read.
    """

    kind: ClassVar[str] = "deflectometry"
    setup: Setup
    pattern: str
    evaluation: Evaluation
    maps: dict[str, SlopeMap]
    assembled: SlopeMap
    assembled_as_measured: SlopeMap
    numbers: Numbers
    facets: dict[str, Numbers]
    cantings: tuple[FacetCanting, ...]
    inputs: tuple[StatedInput, ...]
    texts: dict[str, str]

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        texts = {
            "design": self.assembled.design,
            "removed": self.assembled.removed,
            "frame": self.assembled.frame,
            "camera": f"{self.setup.camera.width_px} x {self.setup.camera.height_px} px",
            "screen": self.setup.screen.describe(),
            "pattern": self.pattern,
            "pose": self.evaluation.located.source,
            "pixels": flag_words(self.evaluation),
            "sigma": "1 standard deviation; slopes are those of the normal, a beam turns by twice as much",
        }
        if self.cantings:
            texts["canting"] = CANTING_SIGN
        texts |= self.texts
        return self._summary(
            self.numbers,
            texts,
            reasons(self.numbers, self.facets),
            facets=self.facets,
            geometry_m=geometry(self.setup, self.evaluation),
        )

    def write_files(self, folder: Path) -> None:
        """Write maps, pixels, cameras and outline into an existing folder."""
        evaluation = self.evaluation
        maps = dict(self.maps)
        if len(evaluation.located.facets) > 1:
            maps[ASSEMBLED] = self.assembled
        attributes = {"name": self.name, "input_sha256": self.input_sha256, "pose": evaluation.located.source}
        write_slope_map(folder / "slope_map.nc", maps, attributes)
        pixels = _pixels(evaluation)
        write_pixels(folder / "pixels.nc", pixels.arrays, {"name": self.name}, cut_out=pixels.cut_out)
        write_cameras_json(folder / "cameras.json", {"camera": self.setup.camera}, _facet_poses(evaluation))
        if evaluation.located.evidence is not None:
            write_table_csv(folder / "outline.csv", _outline_columns(evaluation.located.evidence))
        write_table_csv(folder / INPUTS_FILE, inputs_table(self.inputs))
        write_canting(folder, self.cantings)

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self.summarise())


def _facet_poses(evaluation: Evaluation) -> dict[str, PhotoPose]:
    """Return the pose of each facet; a turn of an ensemble also shifts the facets away from its origin."""
    located, cam_from_mirror = evaluation.located, evaluation.solution.cam_from_mirror
    residual = None if located.evidence is None else located.evidence.residual_rms_px
    poses = {}
    for facet in located.facets:
        carry = np.eye(6)
        carry[3:, :3] = -skew(cam_from_mirror.rotate(facet.ensemble_from_facet.translation_m))
        pose = cam_from_mirror @ facet.ensemble_from_facet
        poses[facet.name] = PhotoPose("camera", pose, carry @ located.pose.covariance @ carry.T, residual)
    return poses


def write_canting(folder: Path, cantings: tuple[FacetCanting, ...]) -> None:
    """Write the canting of each facet and the moves of its mounts; nothing for a single facet."""
    if cantings:
        write_table_csv(folder / CANTING_FILE, _canting_columns(cantings))
    if any(len(one.mounts_m) for one in cantings):
        write_table_csv(folder / MOUNTS_FILE, _mount_columns(cantings))


def _canting_columns(cantings: tuple[FacetCanting, ...]) -> dict[str, Any]:
    places = [one.facet.ensemble_from_facet.apply([*one.facet.reference_point_m, 0.0]) for one in cantings]
    components, sigma = np.full((2, len(cantings)), np.nan), np.full((2, len(cantings)), np.nan)
    for number, one in enumerate(cantings):
        if one.canting is not None:
            components[:, number] = one.canting.components_rad
            sigma[:, number] = np.sqrt(np.diag(one.canting.covariance_components_rad2))
    rise = np.array([one.rise_rad for one in cantings])
    return {
        "facet": [one.facet.name for one in cantings],
        "canting_x_rad": components[0],
        "canting_y_rad": components[1],
        "sigma_canting_x_rad": sigma[0],
        "sigma_canting_y_rad": sigma[1],
        "measured_share": [one.measured_share for one in cantings],
        "x_m": [place[0] for place in places],
        "y_m": [place[1] for place in places],
        "rise_x_rad": rise[:, 0],
        "rise_y_rad": rise[:, 1],
    }


def _mount_columns(cantings: tuple[FacetCanting, ...]) -> dict[str, Any]:
    x, y = np.concatenate([one.mounts_m for one in cantings]).T
    places = np.concatenate([one.mounts_in_ensemble_m for one in cantings])
    return {
        "facet": [one.facet.name for one in cantings for _ in one.mounts_m],
        "mount": [number for one in cantings for number in range(1, 1 + len(one.mounts_m))],
        "x_m": x,
        "y_m": y,
        "move_mm": 1e3 * np.concatenate([one.moves.move_m for one in cantings]),
        "sigma_move_mm": 1e3 * np.concatenate([one.moves.sigma_m for one in cantings]),
        "ensemble_x_m": places[:, 0],
        "ensemble_y_m": places[:, 1],
    }


def _outline_columns(evidence: MirrorPose) -> dict[str, FloatArray]:
    (x_px, y_px), (residual_x_px, residual_y_px) = evidence.points_px.T, evidence.residuals_px.T
    return {"x_px": x_px, "y_px": y_px, "residual_x_px": residual_x_px, "residual_y_px": residual_y_px}


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """What the pixels saw, in the part of the image that holds the mirror."""

    arrays: dict[str, npt.NDArray[Any]]
    cut_out: CutOut


def _pixels(evaluation: Evaluation) -> _Pixels:
    """Put the pixels of all facets together."""
    screen_map = evaluation.screen_map
    outside = np.uint32(SampleFlag.OUTSIDE_MIRROR)
    part = bounding_box(screen_map.flags != outside)
    top, left = (one.start for one in part)
    flags = screen_map.flags[part].copy()
    # As precise as the file keeps them.
    names = ("x", "y", "z", "slope_x", "slope_y", "sigma_x", "sigma_y")
    arrays: dict[str, npt.NDArray[Any]] = {name: np.full(flags.shape, np.nan, dtype=np.float32) for name in names}
    surfaces = dict(zip(evaluation.images, evaluation.solution.surfaces, strict=True))
    for name, image in evaluation.images.items():
        index = [facet.name for facet in evaluation.located.facets].index(name)
        rows = slice(image.row, image.row + image.x_m.shape[0])
        columns = slice(image.column, image.column + image.x_m.shape[1])
        own = evaluation.facet_index[rows, columns] == index
        values: dict[str, npt.NDArray[Any]] = {
            "x": image.x_m,
            "y": image.y_m,
            "z": surfaces[name].height(image.x_m, image.y_m),
            "slope_x": image.slope_x,
            "slope_y": image.slope_y,
            "sigma_x": image.sigma_x,
            "sigma_y": image.sigma_y,
        }
        # The part of a facet lies in that of all of them.
        target = slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left)
        for key, value in values.items():
            np.copyto(arrays[key][target], value, where=own, casting="same_kind")
        np.copyto(flags[target], image.flags, where=own)
    if evaluation.screen_map.grid.spacing_px > 1:
        rows, columns = np.mgrid[part]
        places = screen_map.grid.pixels_px(rows, columns)
        arrays |= {"image_x_px": places[..., 0], "image_y_px": places[..., 1]}
    arrays |= {
        "u": screen_map.u[part],
        "v": screen_map.v[part],
        "sigma_u": screen_map.sigma_u[part],
        "sigma_v": screen_map.sigma_v[part],
        "modulation_dn": screen_map.modulation_dn[part],
        "facet": (evaluation.facet_index[part] + 1).astype(np.int16),
        "flag": flags,
    }
    return _Pixels(arrays, CutOut(screen_map.flags.shape, top, left, {"flag": int(outside)}))
