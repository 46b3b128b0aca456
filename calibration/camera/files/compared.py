"""Two calibrations of one camera against each other, as a result of its own: summary.json and angles.nc."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from calibration.camera.files.summary import comparison_lines, comparison_numbers, comparison_reasons
from calibration.camera.judgement.comparison import Comparison
from heliogauge.results.arrays import LabelledArray, write_arrays
from heliogauge.results.folder import Summary
from heliogauge.results.frame import InstrumentResult

ANGLES_FILE = "angles.nc"


@dataclass(frozen=True, slots=True, eq=False)
class Compared(InstrumentResult):
    """Two calibrations of one camera.

    comparison: Ray by ray.
    """

    kind: ClassVar[str] = "camera-compare"
    comparison: Comparison

    def summarise(self) -> Summary:
        """Collect the angles between the lines of sight, and the chance of such a difference."""
        one = self.comparison
        texts = {
            "angle": "between both lines of sight of a pixel, the best rotation taken out; with_rotation: with it",
            "expected": "RMS that the covariances of both let expect",
        }
        return self._summary(comparison_numbers(one), texts, comparison_reasons(one))

    def write_files(self, folder: Path) -> None:
        """Write angles.nc: the angle over the image, with its sigma."""
        one, axes = self.comparison, ("y", "x")
        arrays = [
            LabelledArray("y", axes[:1], one.y_px, "px", "down in the image"),
            LabelledArray("x", axes[1:], one.x_px, "px", "right in the image"),
            LabelledArray("angle", axes, one.angle_rad, "rad", "angle between both lines of sight"),
            LabelledArray("sigma_angle", axes, one.sigma_rad, "rad", "standard deviation of angle"),
        ]
        write_arrays(folder / ANGLES_FILE, arrays, {"title": f"Two calibrations: {self.name}"})

    def headline(self) -> str:
        """Return how two calibrations differ, in a few lines."""
        return "\n".join(comparison_lines(self.comparison))
