"""What a measurement in several poses gave: its files, its summary, its lines on the terminal."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deflectometry.pipeline.headline import Numbers, headline_text, reasons
from deflectometry.pipeline.result import write_canting
from deflectometry.poses.adjustment import JointSolution
from deflectometry.poses.setup_parameters import SetupParameter, words_of_setup
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import SetupStep
from deflectometry.shape.facet_canting import CANTING_SIGN, FacetCanting
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import PhotoPose, Summary, write_cameras_json, write_slope_map, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import ASSEMBLED
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray

#: A parameter that poses put more than so many of its stated sigmas away was stated wrongly, or its sigma was.
_MOST_SIGMAS = 3.0
#: Tables of a result.
SETUP_FILE, POSES_FILE = "setup.csv", "poses.csv"
#: Parameters that stand among the headline numbers: those that every measurement has, by their names in the table.
_HEADLINE = ("screen width", "screen height", "screen sag in x", "screen sag in y", "camera focal length in x")


@dataclass(frozen=True, slots=True, eq=False)
class PoseRow:
    """One pose of the mirror.

    name: Name of its folder.
    cam_from_mirror: Pose of the mirror as adjusted.
    covariance (6, 6): Its covariance, for camera and screen as adjusted [rad, m].
    roll_rad: How the mirror is turned in the image, counter-clockwise [rad].
    screen_distance_m: From the mirror's origin to the screen's [m].
    residual_px: RMS residual of the outline; None without one [px].
    numbers: Headline numbers of this pose alone, with camera and screen as stated.
    outline_distance_m, sigma_outline_distance_m: Distance from the camera as outline and tape give it [m].
    """

    name: str
    cam_from_mirror: RigidTransform
    covariance: FloatArray
    roll_rad: float
    screen_distance_m: float
    residual_px: float | None
    numbers: Numbers
    outline_distance_m: float = float("nan")
    sigma_outline_distance_m: float = float("nan")

    @property
    def distance_m(self) -> float:
        """Distance of the mirror's origin from the camera [m]."""
        return float(np.linalg.norm(self.cam_from_mirror.translation_m))

    @property
    def sigma_distance_m(self) -> float:
        """Its standard deviation [m]."""
        along = self.cam_from_mirror.translation_m / self.distance_m
        return float(np.sqrt(along @ self.covariance[3:, 3:] @ along))


@dataclass(frozen=True, slots=True, eq=False)
class PosesResult(InstrumentResult):
    """The mirror, camera and screen from several poses.

    Parameters
    ----------
    setup : Setup
        Camera and screen as adjusted.
    steps : tuple of SetupStep
        The errors of the setup that all poses have in common.
    parameters : tuple of SetupParameter
        What they are in parameters of camera and screen, stated and found.
    solution : JointSolution
        Amounts of all errors.
    poses : tuple of PoseRow
        Where the mirror stood, and what each pose alone gives.
    maps : dict of str to SlopeMap
        One map of each facet from all poses, after what was to be removed.
    assembled : SlopeMap
        The map of the whole mirror.
    numbers : dict of str to number
        Headline numbers of the mirror.
    facets : dict of str to dict
        Headline numbers of each facet; empty for a single one.
    cantings : tuple of FacetCanting
        Canting of each facet of an ensemble; empty for a single facet.
    """

    kind: ClassVar[str] = "deflectometry-poses"
    setup: Setup
    steps: tuple[SetupStep, ...]
    parameters: tuple[SetupParameter, ...]
    solution: JointSolution
    poses: tuple[PoseRow, ...]
    maps: dict[str, SlopeMap]
    assembled: SlopeMap
    numbers: Numbers
    facets: dict[str, Numbers]
    cantings: tuple[FacetCanting, ...]

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        numbers = dict(self.numbers)
        for one in self.parameters:
            if one.name in _HEADLINE:
                key = f"{one.name.replace(' ', '_')}_{one.unit}"
                numbers |= {key: one.found, f"sigma_{key}": one.sigma_found}
        numbers |= {
            "poses_count": len(self.poses),
            "poses_noise_factor": self.solution.noise_factor,
            "poses_agreement_probability": self.solution.probability,
        }
        texts = {
            "design": self.assembled.design,
            "removed": self.assembled.removed,
            "frame": self.assembled.frame,
            "camera": f"{self.setup.camera.width_px} x {self.setup.camera.height_px} px",
            "screen": self.setup.screen.describe(),
            "poses": ", ".join(one.name for one in self.poses),
            "setup": words_of_setup(self.parameters),
            "sigma": "1 standard deviation; slopes are those of the normal, a beam turns by twice as much",
        }
        if self.cantings:
            texts["canting"] = CANTING_SIGN
        return self._summary(numbers, texts, reasons(numbers, self.facets), facets=self.facets)

    def write_files(self, folder: Path) -> None:
        """Write maps, the tables of setup and poses, and cameras into an existing folder."""
        maps = dict(self.maps)
        if len(maps) > 1:
            maps[ASSEMBLED] = self.assembled
        write_slope_map(folder / "slope_map.nc", maps, {"name": self.name, "input_sha256": self.input_sha256})
        write_table_csv(folder / SETUP_FILE, setup_columns(self.parameters))
        write_table_csv(folder / POSES_FILE, pose_columns(self.poses))
        poses = {
            one.name: PhotoPose("camera", one.cam_from_mirror, one.covariance, one.residual_px) for one in self.poses
        }
        write_cameras_json(folder / "cameras.json", {"camera": self._camera()}, poses)
        write_canting(folder, self.cantings)

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        lines = [headline_text(self.summarise()), f"  {len(self.poses)} poses; camera and screen, stated and found:"]
        for one in self.parameters:
            stated = number_text(one.stated, one.sigma_stated, one.unit)
            found = number_text(one.found, one.sigma_found, one.unit)
            lines.append(f"    {one.name:<32} {stated:<26} {found}")
        return "\n".join(lines)

    def _camera(self) -> Camera:
        """Return the camera as found, with the covariance that the poses leave it."""
        steps = np.array([one.camera for one in self.steps]).reshape(-1, 10)
        covariance = self.solution.covariance_common[: len(steps), : len(steps)]
        return self.setup.camera.with_covariance(steps.T @ covariance @ steps)


def doubts_of_setup(parameters: Sequence[SetupParameter]) -> Iterator[Doubt]:
    """Yield each parameter that the poses put farther from its stated value than its sigma allows."""
    for one in parameters:
        if abs(one.sigmas) > _MOST_SIGMAS:
            yield Doubt(
                "stated_setup_contradicts_poses",
                f"{one.name}: the poses give {number_text(one.found, one.sigma_found, one.unit)}, "
                f"{abs(one.sigmas):.1f} of its stated sigmas from "
                f"{number_text(one.stated, one.sigma_stated, one.unit)} in measurement.toml; the found value was used: "
                "measure it again, and state what is right or how sure it really is",
                {"off_sigmas_factor": abs(one.sigmas)},
            )


def setup_columns(parameters: Sequence[SetupParameter]) -> dict[str, list[Any]]:
    """Return the table of the parameters of camera and screen, stated and found, in the unit of each row."""
    return {
        "parameter": [one.name for one in parameters],
        "unit": [one.unit for one in parameters],
        "stated": [one.stated for one in parameters],
        "sigma_stated": [one.sigma_stated for one in parameters],
        "found": [one.found for one in parameters],
        "sigma_found": [one.sigma_found for one in parameters],
        "moved_in_stated_sigmas": [one.sigmas for one in parameters],
        "determined_share": [one.determined_share for one in parameters],
    }


def pose_columns(poses: Sequence[PoseRow]) -> dict[str, list[Any]]:
    """Return the table of the poses: where the mirror stood, and the focal lengths that each alone gives as stated."""
    columns: dict[str, list[Any]] = {
        "pose": [one.name for one in poses],
        "roll_rad": [one.roll_rad for one in poses],
        "camera_distance_m": [one.distance_m for one in poses],
        "sigma_camera_distance_m": [one.sigma_distance_m for one in poses],
        "outline_distance_m": [one.outline_distance_m for one in poses],
        "sigma_outline_distance_m": [one.sigma_outline_distance_m for one in poses],
        "screen_distance_m": [one.screen_distance_m for one in poses],
        "residual_px": [float("nan") if one.residual_px is None else one.residual_px for one in poses],
    }
    for key in ("curvature_x_per_m", "curvature_y_per_m"):
        for name in (key, f"sigma_{key}"):
            columns[f"alone_{name}"] = [float(one.numbers[name] or 0.0) for one in poses]
    return columns
