"""The result of a trough measurement: its files, its headline numbers, its lines on a terminal."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.folder import PhotoPose, Summary, write_cameras_json, write_points_csv, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.slope_map_file import write_slope_map
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.absorber.position import AbsorberSolution
from observer.absorber.product import absorber_columns, shape_numbers, span_columns, tube_spans
from observer.files import (
    ANGLES,
    COLLECTOR,
    NETWORK_FOLDER,
    SLICES,
    write_angles,
    write_collector,
    write_overlay,
    write_slices,
)
from observer.pipeline.headline import (
    absorber_numbers,
    edge_numbers,
    halves_numbers,
    headline_text,
    panel_columns,
    shutter_numbers,
    slope_numbers,
    surface_numbers,
    surface_text,
)
from observer.pipeline.intercept import InterceptResult, intercept_numbers, write_intercept
from observer.pipeline.reading.photos import SeenInPhotos
from observer.product.pictures import Overlay
from observer.product.slope_map import AngleMaps
from observer.selection.edge_refusal import EdgeFate
from observer.selection.solve_and_refuse import Reflector
from observer.shutter.readout import RowMotions
from observer.slopes.pose_modes import Photos
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector
from observer.trough.visibility import Visibility
from photogrammetry import pipeline as photogrammetry_pipeline


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """Everything a measurement gave, ready to be written.

    Parameters
    ----------
    collector : Collector
        The design.
    orientation_rad : float
        Turn of the collector from zenith, by the right hand about +y [rad].
    network : photogrammetry.pipeline.Result
        Cameras and targets.
    seen : SeenInPhotos
        Edges and bearings.
    absorber : AbsorberPath
        The tube's axis, adjusted together with the slopes.
    absorber_solution : AbsorberSolution or None
        Its measurement; None where it was given.
    reflector : Reflector
        The mirror's slope errors.
    slope_map : SlopeMap
        The same in the common form.
    visible : Visibility
        What the cameras can see of the tube by way of each node.
    angles : AngleMaps
        The same as angles, with the absorber's share.
    intercept : InterceptResult
        What mirror and absorber collect.
    photos : Photos
        Poses of the photos with their joint covariance, as estimated from the targets.
    poses : tuple of RigidTransform
        The same as the reflection has refined them, ``cam_from_frame``.
    pose_covariances : ndarray, shape (n, 6, 6)
        Of the steps of each [rad, m].
    overlay : Overlay
        One photo with what design and result predict of the reflection.
    motions : RowMotions or None
        How the camera moved while it read its rows; None where all were read at once.
    n_modules : int
        Modules of the flight, this one among them.
    name : str
        Name of what was measured.
    doubts : tuple of Doubt
        What makes the result doubtful.
    durations_s : mapping of str to float
        Wall time of each stage [s].
    input_sha256 : mapping of str to str
        Hash of each file that was read.
    """

    kind: ClassVar[str] = "observer"
    collector: Collector
    orientation_rad: float
    network: photogrammetry_pipeline.Result
    seen: SeenInPhotos
    absorber: AbsorberPath
    absorber_solution: AbsorberSolution | None
    reflector: Reflector
    slope_map: SlopeMap
    visible: Visibility
    angles: AngleMaps
    intercept: InterceptResult
    photos: Photos
    poses: tuple[RigidTransform, ...]
    pose_covariances: FloatArray
    overlay: Overlay
    motions: RowMotions | None = None
    n_modules: int = 1

    def summarise(self) -> Summary:
        """Collect the headline numbers of a result with their sigmas, doubts and provenance."""
        bundle = self.network.solved.bundle
        collected, missing = intercept_numbers(self.intercept)
        surface, unseen = surface_numbers(self.reflector)
        numbers = {
            **slope_numbers(self.slope_map, self.angles, self.visible),
            **absorber_numbers(self.absorber, self.collector, self.absorber_solution),
            **shape_numbers(self.absorber, self.absorber_solution, self.collector, self.orientation_rad),
            "orientation_rad": self.orientation_rad,
            **edge_numbers(self.reflector),
            **surface,
            **halves_numbers(self.reflector, self.n_modules),
            **collected,
            "photos_count": len(bundle.problem.observations.photos),
            **shutter_numbers(self.motions),
            "image_residual_rms_px": float(np.sqrt((bundle.residuals_px**2).sum(axis=1).mean())),
            **({} if self.network.positions is None else self.network.positions.numbers),
        }
        texts = {
            "design": self.slope_map.design,
            "removed": self.slope_map.removed,
            "frame": self.slope_map.frame,
            "surface": surface_text(self.reflector),
            "encoding": self.seen.encodings.text(),
            "light": self.intercept.light,
            "intercept": self.intercept.assumption,
            "datum": bundle.datum,
            "sign": "slope_x = dz/dx; theta_r = -(its angle error), positive where the normal is turned towards +x",
            "rejected": f"{len(self.network.refused)} image points and photos, see rejected.csv",
        }
        return self._summary(numbers, texts, missing | unseen)

    def write_files(self, folder: Path) -> None:
        """Write maps, edges, cameras and tables into an existing folder."""
        write_slope_map(folder / "slope_map.nc", {"": self.slope_map}, {"input_sha256": self.input_sha256})
        write_angles(folder / ANGLES, self.slope_map, self.angles)
        write_collector(folder / COLLECTOR, self.collector)
        names = self.network.solved.bundle.problem.observations.photos
        write_slices(folder / SLICES, self.seen.slices, self.photos.eyes_m, names)
        write_overlay(folder, self.overlay, names[self.overlay.photo])
        network = folder / NETWORK_FOLDER
        network.mkdir()
        self.network.write(network)
        write_intercept(self.intercept, folder)
        panels = panel_columns(self.slope_map, self.angles, self.collector, self.intercept.panels, self.reflector)
        write_table_csv(folder / "panels.csv", panels)
        tube, solution, collector = self.absorber, self.absorber_solution, self.collector
        write_table_csv(folder / "absorber.csv", absorber_columns(tube, solution, collector))
        spans = tube_spans(tube, solution, collector, self.orientation_rad)
        write_table_csv(folder / "absorber_spans.csv", span_columns(spans))
        write_points_csv(folder / "points.csv", self.network.points)
        write_cameras_json(folder / "cameras.json", self.network.cameras, self.refined_poses())
        write_table_csv(folder / "reflection_edges.csv", _edge_columns(self))
        refused = self.network.refused
        write_table_csv(
            folder / "rejected.csv", {"name": [one.name for one in refused], "reason": [one.reason for one in refused]}
        )

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self.summarise())

    def refined_poses(self) -> dict[str, PhotoPose]:
        """Return the poses of all photos as targets and reflection together have them.

        Returns: By the photo's name; residuals are those of the targets.
        """
        before = self.network.photo_poses
        both = zip(before.items(), self.poses, self.pose_covariances, strict=True)
        return {
            name: replace(one, cam_from_world=pose, covariance=covariance) for (name, one), pose, covariance in both
        }


def _edge_columns(result: Result) -> dict[str, Any]:
    edges, reflector = result.seen.edges, result.reflector
    names = np.array(result.network.solved.bundle.problem.observations.photos)
    codes = np.array([fate.code for fate in EdgeFate])
    return {
        "image": names[edges.photo],
        # A thousandth of their sigma.
        "x_m": edges.points_m[:, 0].round(7),
        "y_m": edges.points_m[:, 1].round(7),
        "side": edges.side.astype(int),
        "sigma_x_m": edges.sigma_x_m.round(7),
        "residual_rad": reflector.residuals_rad.round(9),
        "fate": codes[reflector.fate],
    }
