"""Photos of a screen to its geometry: the stages follow each other in `run`."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from deflectometry.screen_geometry.keys import ScreenMeasurement
from deflectometry.screen_geometry.measured_screen import MeasuredScreen
from deflectometry.screen_geometry.pipeline.network import ScreenNetwork, see, solve
from deflectometry.screen_geometry.pipeline.screen_file import SCREEN_FILE, write_screen
from deflectometry.screen_geometry.screen_shape import ShapeTest, describe_display, describe_dots
from deflectometry.setup.dot_screen import DotScreen
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import showing
from heliogauge.measurement.writer import dump_toml, write_text
from heliogauge.results.folder import Summary, hash_files, refuse_copies
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.tables import write_table_csv
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import FloatArray

#: Table of the screen's points, and of its errors.
POINTS_FILE = "screen.csv"
#: Section for the measurement.toml of a deflectometry measurement.
SECTION_FILE = "screen.toml"
#: Nodes per side of the table of a display.
_NODES = 11
#: More than this share of image points left out is said.
_LEFT_OUT_SHARE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """The geometry of a screen.

    measured: Points, what they share, and the pose of the measuring camera.
    network: The adjusted photos.
    tests: How well each form that was tried describes a display; empty for dots.
    """

    kind: ClassVar[str] = "screen-geometry"
    measured: MeasuredScreen
    network: ScreenNetwork
    tests: tuple[ShapeTest, ...] = ()

    @property
    def is_dots(self) -> bool:
        """Whether the screen is a field of dots."""
        return isinstance(self.measured.screen, DotScreen)

    def points(self) -> dict[str, npt.NDArray[Any]]:
        """Return the columns of the table of points: each dot, or nodes of the display."""
        screen = self.measured.screen
        if isinstance(screen, DotScreen):
            row, column = np.nonzero(np.isfinite(screen.xyz_m[..., 0]))
            rows, columns = screen.shape
            u, v = column / (columns - 1), row / (rows - 1)
            names: dict[str, npt.NDArray[Any]] = {"column": column + screen.first[0], "row": screen.first[1] - row}
            xyz = screen.xyz_m[row, column]
        else:
            nodes = np.linspace(0.0, 1.0, _NODES)
            u, v = (one.ravel() for one in np.meshgrid(nodes, nodes))
            names, xyz = {"u": u, "v": v}, screen.points_m(u, v)
        sigma = self.measured.sigma_points_m(u, v)
        for axis, letter in enumerate("xyz"):
            names[f"{letter}_m"] = xyz[:, axis]
        for axis, letter in enumerate("xyz"):
            names[f"sigma_{letter}_m"] = sigma[:, axis]
        return names

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        table = self.points()
        xyz = np.stack([table[f"{one}_m"] for one in "xyz"], axis=1)
        sigmas = [float(np.sqrt(np.mean(table[f"sigma_{one}_m"] ** 2))) for one in "xyz"]
        size, sigma_size = self._size()
        flat = _departure(xyz)
        solved = self.network.result.solved
        count = solved.bundle.problem.observations.n
        numbers: dict[str, float | int | None] = {
            "width_m": size[0],
            "sigma_width_m": sigma_size[0],
            "height_m": size[1],
            "sigma_height_m": sigma_size[1],
            "out_of_plane_rms_m": float(np.sqrt(np.mean(flat**2))),
            "out_of_plane_range_m": float(np.ptp(flat)),
            "sigma_x_m": sigmas[0],
            "sigma_y_m": sigmas[1],
            "sigma_z_m": sigmas[2],
            "points_count": len(self.network.points.u),
            "image_points_count": count,
            "left_out_image_points_count": len(solved.rejected),
            "photos_count": len(solved.bundle.problem.observations.photos),
        }
        texts = {
            "screen": self.measured.screen.describe(),
            "origin": f"which point is which: {self.network.origin}",
            "frame": solved.bundle.datum
            if self.network.own_frame is False
            else "origin in the middle of the points, x to the right, y up, z towards the viewer",
            "sigma": "1 standard deviation, RMS over the points, in the frame of the result",
        }
        pose = self.measured.cam_from_screen
        if pose is None:
            texts["measuring camera"] = (
                "no photo of it (measuring_photo): state its pose in the deflectometry measurement"
            )
        else:
            sigma = np.sqrt(np.diag(self.measured.covariance_pose))
            numbers |= {
                "camera_distance_m": float(np.linalg.norm(pose.translation_m)),
                "sigma_camera_rotation_rad": float(np.sqrt(np.mean(sigma[:3] ** 2))),
                "sigma_camera_place_m": float(np.sqrt(np.mean(sigma[3:] ** 2))),
            }
        if self.tests:
            texts["form"] = "; ".join(
                f"{one.form}: chi-square {one.chi_square:.1f} for {one.freedom}, probability {one.probability:.2g}"
                for one in self.tests
            )
        lost = dict.fromkeys(("width_m", "sigma_width_m", "height_m", "sigma_height_m")) if np.isnan(size[0]) else {}
        return self._summary(numbers | lost, texts, dict.fromkeys(lost, "no row or column of dots has both ends"))

    def _size(self) -> tuple[FloatArray, FloatArray]:
        """Return width and height through the middle, and their sigmas [m]."""
        u, v = np.array([0.0, 1.0, 0.5, 0.5]), np.array([0.5, 0.5, 0.0, 1.0])
        screen = self.measured.screen
        if isinstance(screen, DotScreen):
            # The row and the column nearest to the middle that have both ends.
            rows, columns = screen.shape
            there = np.isfinite(screen.xyz_m[..., 0])
            whole_rows, whole_columns = (
                np.flatnonzero(one) for one in (there[:, [0, -1]].all(1), there[[0, -1]].all(0))
            )
            if not (whole_rows.size and whole_columns.size):
                return np.full(2, np.nan), np.full(2, np.nan)
            v[:2] = whole_rows[np.argmin(np.abs(whole_rows - 0.5 * rows))] / (rows - 1)
            u[2:] = whole_columns[np.argmin(np.abs(whole_columns - 0.5 * columns))] / (columns - 1)
        ends = screen.points_m(u, v)
        across = ends[[1, 3]] - ends[[0, 2]]
        size = np.linalg.norm(across, axis=1)
        variance = np.zeros(2)
        for one in self.measured.shared:
            moved = one.warp.shifts_m(u, v)
            variance += np.einsum("ni,ni->n", moved[[1, 3]] - moved[[0, 2]], across / size[:, None]) ** 2
        return size, np.sqrt(variance)

    def write_files(self, folder: Path) -> None:
        """Write screen.nc, screen.csv, screen.toml and the table of the forms into an existing folder."""
        write_screen(folder / SCREEN_FILE, self.measured, self.name)
        write_table_csv(folder / POINTS_FILE, self.points())
        pose = self.measured.cam_from_screen
        section: dict[str, object] = {"shape": "measured", "file": SCREEN_FILE}
        text = "# Copy screen.nc beside the measurement.toml of a deflectometry measurement; this is its [screen].\n"
        if pose is None:
            text += "# Its pose cam_from_screen must be added: rotation_vector_rad, translation_m and their sigmas.\n"
        write_text(folder / SECTION_FILE, text + dump_toml({"screen": section}))
        if self.tests:
            columns: dict[str, list[Any]] = {
                "form": [one.form for one in self.tests],
                "chi_square": [one.chi_square for one in self.tests],
                "freedom": [one.freedom for one in self.tests],
                "probability": [one.probability for one in self.tests],
            }
            write_table_csv(folder / "forms.csv", columns)

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        numbers = self.summarise().numbers

        def value(key: str, factor: float = 1e3) -> float:
            found = numbers[key]
            return factor * float(found) if found is not None else float("nan")

        lines = [
            f"{self.name}: {self.measured.screen.describe()}",
            f"  size             {value('width_m', 1):.4f} m x {value('height_m', 1):.4f} m, sigma "
            f"{value('sigma_width_m'):.2g} mm and {value('sigma_height_m'):.2g} mm",
            f"  out of plane     {value('out_of_plane_rms_m'):.2f} mm RMS, {value('out_of_plane_range_m'):.1f} mm "
            "in all",
            f"  sigma of points  {value('sigma_x_m'):.3f} / {value('sigma_y_m'):.3f} / {value('sigma_z_m'):.3f} mm "
            "(x, y, z)",
            f"  origin           {self.network.origin}",
        ]
        if self.measured.cam_from_screen is not None:
            lines.append(
                f"  measuring camera {value('camera_distance_m', 1):.4f} m from the screen's middle, sigma "
                f"{value('sigma_camera_rotation_rad'):.3f} mrad and {value('sigma_camera_place_m'):.2f} mm"
            )
        return "\n".join(lines)


def run(measurement: ScreenMeasurement, progress: Progress | None = None) -> Result:
    """Find the geometry of a screen from photos of it.

    Parameters
    ----------
    measurement : ScreenMeasurement
        From `load_screen`.
    progress : Progress, optional
        Reports each stage.

    Returns
    -------
    Result
        Points, shape, and the pose of the measuring camera, with what they share.

    Raises
    ------
    InputError
        Photos or tables that cannot be used.
    EstimationError
        The photos do not hang together, or do not say which dot is which.
    """
    progress = progress or SilentProgress()
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    refuse_copies(measurement.photo_files, hashes, measurement.folder)
    seen = see(measurement, progress)
    with showing(seen.targets.pictures):
        network = solve(measurement, seen, progress)
    return describe(measurement, network, hashes, progress)


def describe(
    measurement: ScreenMeasurement, network: ScreenNetwork, hashes: Mapping[str, str], progress: Progress
) -> Result:
    """Describe the screen whose points an adjusted network has.

    hashes: Of the files that were read.
    EstimationError: Too few points for its form, or points on a line.
    """
    model = measurement.model
    own_frame = model.shape.frame == "screen"
    tests: tuple[ShapeTest, ...] = ()
    with progress.stage("shape"):
        if model.dots is not None:
            measured = describe_dots(network.points, network.number, own_frame=own_frame)
        else:
            measured, tests = describe_display(network.points, model.shape.form, own_frame=own_frame)
    return Result(
        measured=measured,
        network=network,
        tests=tests,
        name=model.name,
        doubts=gather_doubts(
            network.doubts, _off_surface(measured, tests), _left_out(network), _exact_camera(measurement)
        ),
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _departure(xyz_m: FloatArray) -> FloatArray:
    """Return how far points are off the plane through them, shape (n,) [m]."""
    centred = xyz_m - xyz_m.mean(axis=0)
    return np.asarray(centred @ np.linalg.svd(centred, full_matrices=False)[2][2])


def _off_surface(measured: MeasuredScreen, tests: tuple[ShapeTest, ...]) -> Doubt | None:
    if not measured.sigma_surface_m > 0:
        return None
    last = tests[-1]
    return Doubt(
        "screen_points_off_surface",
        f"the points are off a {last.form} display by {1e3 * measured.sigma_surface_m:.2g} mm more than their noise "
        f"(chi-square {last.chi_square:.0f} for {last.freedom}); counted as sigma of the surface; do all targets "
        "lie on the display, and are their fractions u, v right?",
        {"sigma_surface_m": measured.sigma_surface_m},
    )


def _exact_camera(measurement: ScreenMeasurement) -> Doubt | None:
    """Return a note where nothing of any camera is estimated: then no sigma holds what is not known of them."""
    if any(one.estimated for one in measurement.model.camera):
        return None
    names = ", ".join(one.name for one in measurement.model.camera)
    return Doubt(
        "screen_camera_exact",
        f"nothing of the cameras ({names}) is estimated: they count as exact, and sigmas of the screen hold noise and "
        "what is known of lengths and targets alone; name in `free` of [[camera]] what is not known exactly, with its "
        "`sigma`",
        {"cameras_count": len(measurement.model.camera)},
        Severity.NOTE,
    )


def _left_out(network: ScreenNetwork) -> Doubt | None:
    solved = network.result.solved
    count = solved.bundle.problem.observations.n + len(solved.rejected)
    share = len(solved.rejected) / max(count, 1)
    if share <= _LEFT_OUT_SHARE:
        return None
    return Doubt(
        "many_image_points_left_out",
        f"{len(solved.rejected)} of {count} image points contradict the others and are left out; check that nothing "
        "moved between the photos, and the camera",
        {"left_out_share": share},
    )
