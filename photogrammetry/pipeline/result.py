"""What a measurement gave: image points, the adjusted network, its lengths, the surface, what is doubtful."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from heliogauge.camera.millimetres import Sensor
from heliogauge.camera.model import Camera
from heliogauge.flags import SampleFlag
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    Summary,
    write_cameras_json,
    write_points_csv,
    write_table_csv,
)
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.thumbnails import write_thumbnails
from photogrammetry.bundle.constraints import Distance
from photogrammetry.networks.length_error import LengthStatement
from photogrammetry.networks.position_scale import PositionScale
from photogrammetry.networks.quality import network_numbers, quality_texts
from photogrammetry.networks.solve_network import Solved
from photogrammetry.pipeline.headline import headline_text
from photogrammetry.pipeline.photos import MeasuredPhotos
from photogrammetry.pipeline.surface import SurfaceResult
from photogrammetry.pipeline.surface_files import surface_numbers, write_surface
from photogrammetry.pipeline.tables import (
    constraint_columns,
    covariance_columns,
    intrinsic_columns,
    length_columns,
    millimetre_columns,
    place_columns,
    residual_columns,
)
from photogrammetry.start_values.network import ImagePlace, LeftOut


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """Everything a measurement gave, ready to be written.

    measured: All image points, and what in the photos was refused.
    solved: The adjusted network.
    checks: Scale bars that were not used, to check against.
    lengths: Known lengths against a network that did not use them.
    sensors: Of the cameras that were given in millimetres.
    surface: The surface under the targets, where ``[surface]`` asks for it.
    positions: Size of the flight by the drone's own positions, where ``[positions]`` asks for it.
    """

    kind: ClassVar[str] = "photogrammetry"
    measured: MeasuredPhotos
    solved: Solved
    checks: tuple[Distance, ...]
    lengths: LengthStatement
    sensors: dict[str, Sensor] = field(default_factory=dict)
    surface: SurfaceResult | None = None
    positions: PositionScale | None = None

    @property
    def camera(self) -> Camera:
        """The first camera with the covariance of its parameters."""
        return self.solved.bundle.cameras[0]

    @property
    def cameras(self) -> dict[str, Camera]:
        """All cameras by name, with the covariance of their parameters."""
        bundle = self.solved.bundle
        return {model.name: one for model, one in zip(bundle.problem.cameras, bundle.cameras, strict=True)}

    @property
    def points(self) -> PointTable:
        """Coordinates with standard deviations; targets left out stand at the end without coordinates."""
        bundle, left = self.solved.bundle, self.solved.network.targets_left_out
        table = bundle.problem.observations
        rays = table.n_rays
        kept = np.nonzero(rays > 0)[0]
        gone = np.full((len(left), 3), np.nan)
        flags = np.array([0] * len(kept) + [int(SampleFlag.NOT_SEEN)] * len(left), dtype=np.uint32)
        return PointTable(
            tuple(table.targets[i] for i in kept) + tuple(one.name for one in left),
            np.concatenate([bundle.points_m[kept], gone]),
            np.concatenate([bundle.sigma_points_m[kept], gone]),
            np.concatenate([rays[kept], np.zeros(len(left), dtype=np.intp)]).astype(np.int64),
            flags,
        )

    @property
    def photo_poses(self) -> dict[str, PhotoPose]:
        """Camera, pose with covariance and size of the residuals of each photo in the network, by its name."""
        bundle = self.solved.bundle
        table, squares = bundle.problem.observations, (bundle.residuals_px**2).sum(axis=1)
        counts = np.maximum(table.n_targets_in_photo, 1)
        rms = np.sqrt(np.bincount(table.photo_index, weights=squares, minlength=len(table.photos)) / counts)
        covariances = bundle.covariance.poses
        owners = [bundle.problem.cameras[place].name for place in bundle.problem.camera_index]
        return {
            name: PhotoPose(owners[i], pose, 0.5 * (covariances[i] + covariances[i].T), float(rms[i]))
            for i, (name, pose) in enumerate(zip(table.photos, bundle.cam_from_world, strict=True))
        }

    @property
    def refused(self) -> tuple[LeftOut, ...]:
        """Everything that was not used, by name with the reason."""
        solved = self.solved
        places = self._places_of({one.target for one in solved.rejected})
        outliers = [
            LeftOut(
                one.label,
                f"{one.reason}, residual {one.residual_px:.2f} px",
                is_outlier=one.is_outlier,
                place=places.get(one.label),
            )
            for one in solved.rejected
        ]
        left = (*solved.network.suspicious, *solved.network.photos_left_out, *solved.network.targets_left_out)
        return (*self.measured.refused, *left, *solved.unused, *solved.weak, *outliers)

    def _places_of(self, targets: set[str]) -> dict[str, ImagePlace]:
        """Return where the image points of some targets are, by their labels."""
        table = self.measured.points
        rows = np.nonzero([table.targets[i] in targets for i in table.target_index])[0].tolist() if targets else []
        return {
            table.label(row): ImagePlace(table.photos[table.photo_index[row]], *table.pixels_px[row].tolist())
            for row in rows
        }

    @property
    def _unmatched_dots(self) -> tuple[ImagePlace, ...]:
        """Dots without a code that no point of the network was found for."""
        loose, table = self.measured.loose, self.measured.points
        if loose is None:
            return ()
        used = set(zip(table.photo_index.tolist(), *table.pixels_px.T.tolist(), strict=True))
        number = {name: i for i, name in enumerate(table.photos)}
        places = [
            ImagePlace(loose.photos[photo], x, y)
            for photo, (x, y) in zip(loose.dots.photo_index.tolist(), loose.dots.pixels_px.tolist(), strict=True)
        ]
        return tuple(one for one in places if (number.get(one.photo, -1), one.x_px, one.y_px) not in used)

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        bundle = self.solved.bundle
        numbers, missing = network_numbers(self.solved, self.lengths)
        if self.positions is not None:
            numbers |= self.positions.numbers
        seen = {*self.measured.points.photos, *self.measured.thumbnails}
        numbers |= {
            "left_out_photos_count": len(seen - set(self.photo_poses)),
            "left_out_points_count": len(self.solved.network.targets_left_out),
        }
        described = [
            f"{model.name}: {one.width_px} x {one.height_px} px; estimated: {', '.join(model.free) or 'nothing'}"
            for model, one in zip(bundle.problem.cameras, bundle.cameras, strict=True)
        ]
        scale = "residuals" if self.solved.image_sigma_factor != 1.0 else "statement"
        texts = {
            "datum": bundle.datum,
            "camera": "; ".join(described if len(described) > 1 else [described[0].partition(": ")[2]]),
            "sigma": f"1 standard deviation under this datum; size of the image points' sigmas from their {scale}",
            "rejected": f"{len(self.refused)} items, see rejected.csv",
            **quality_texts(self.lengths, float(numbers["extent_m"] or 0.0)),
        }
        if self.surface is not None:
            own = surface_numbers(self.surface)
            numbers, texts, missing = numbers | own.numbers, texts | own.texts, missing | own.not_determined
        return self._summary(numbers, texts, missing)

    def write_files(self, folder: Path) -> None:
        """Write tables, cameras and surface into an existing folder."""
        bundle = self.solved.bundle
        write_points_csv(folder / "points.csv", self.points)
        write_cameras_json(folder / "cameras.json", self.cameras, self.photo_poses)
        write_table_csv(folder / "points_covariance.csv", covariance_columns(bundle))
        write_table_csv(folder / "residuals.csv", residual_columns(bundle))
        refused = self.refused
        rejected: dict[str, list[Any]] = {
            "name": [one.name for one in refused],
            "reason": [one.reason for one in refused],
            "is_outlier": [int(one.is_outlier) for one in refused],
            **place_columns([one.place for one in refused]),
        }
        write_table_csv(folder / "rejected.csv", rejected)
        if dots := self._unmatched_dots:
            write_table_csv(folder / "unmatched_dots.csv", place_columns(dots))
        write_table_csv(folder / "constraints.csv", constraint_columns(bundle, self.checks))
        write_table_csv(folder / "lengths.csv", length_columns(self.lengths))
        write_table_csv(folder / "intrinsics.csv", intrinsic_columns(bundle))
        write_thumbnails(folder, self._thumbnails)
        if self.sensors:
            write_table_csv(folder / "camera_millimetres.csv", millimetre_columns(self.cameras, self.sensors))
        if self.surface is not None:
            write_surface(self.surface, folder, {"name": self.name, "input_sha256": self.input_sha256})

    @property
    def _thumbnails(self) -> dict[str, bytes]:
        """Thumbnails, photos that are not in the network first, then those with the largest residuals."""
        poses = self.photo_poses
        rms = {name: pose.residual_rms_px or 0.0 for name, pose in poses.items()}
        order = sorted(self.measured.thumbnails, key=lambda name: -rms.get(name, np.inf))
        return {name: self.measured.thumbnails[name] for name in order}

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        return headline_text(self.summarise())
