"""Camera and screen as stated and as the poses found them: amounts of errors become parameters with units."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deflectometry.poses.adjustment import JointSolution
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.setup.setup_steps import SetupStep, Warp
from heliogauge.camera.model import PARAMETER_NAMES
from heliogauge.validate import FloatArray

#: Below this share of its variance taken away the poses say nothing of a parameter: its sigma is a tenth smaller.
LEAST_DETERMINED = 0.19


@dataclass(frozen=True, slots=True)
class SetupParameter:
    """A parameter of camera or screen.

    name: What it is.
    unit: "m", "rad", "px" or "".
    stated, sigma_stated: As in measurement.toml.
    found, sigma_found: After the adjustment.
    """

    name: str
    unit: str
    stated: float
    sigma_stated: float
    found: float
    sigma_found: float

    @property
    def sigmas(self) -> float:
        """How far it moved, in stated sigmas."""
        return (self.found - self.stated) / self.sigma_stated

    @property
    def determined_share(self) -> float:
        """Share of its stated variance that the poses took away: 0 where they say nothing of it."""
        return max(1.0 - (self.sigma_found / self.sigma_stated) ** 2, 0.0)


def setup_parameters(setup: Setup, steps: Sequence[SetupStep], solution: JointSolution) -> tuple[SetupParameter, ...]:
    """Return the parameters that have a stated sigma, stated and found.

    setup: As stated.
    steps: The common errors, in the order of the solution.
    """
    return tuple(_parameters(setup, steps, solution))


def _parameters(setup: Setup, steps: Sequence[SetupStep], solution: JointSolution) -> Iterator[SetupParameter]:
    def one(name: str, unit: str, stated: float, by_steps: FloatArray) -> Iterator[SetupParameter]:
        sigma = float(np.linalg.norm(by_steps))
        if sigma > 0:
            count = by_steps.size
            found = stated + float(by_steps @ solution.common[:count])
            sigma_found = float(np.sqrt(by_steps @ solution.covariance_common[:count, :count] @ by_steps))
            yield SetupParameter(name, unit, stated, sigma, found, sigma_found)

    sizes = _sizes_m(setup)
    warps = [(index, step.source, step.warp) for index, step in enumerate(steps) if isinstance(step.warp, Warp)]
    for index, source, warp in warps:
        alone = np.zeros(len(steps))
        across = "x" if warp.order[0] else "y"
        if source == "screen size":
            alone[index] = abs(warp.rms_m) * np.sqrt(12.0)
            yield from one(("screen width", "screen height")[warp.axis], "m", float(sizes[warp.axis]), alone)
        elif source == "screen sag":
            alone[index] = warp.rms_m * 1.5 * np.sqrt(5.0)
            yield from one(f"screen sag in {across}", "m", 0.0, alone)
        else:
            alone[index] = warp.rms_m
            bent = "".join(letter * order for letter, order in zip("uv", warp.order, strict=True))
            yield from one(f"screen shape, {'xyz'[warp.axis]} by {bent}", "m", 0.0, alone)
    pose = np.array([step.cam_from_screen for step in steps]).reshape(-1, 6)
    for axis in range(3):
        yield from one(f"screen turned about {'xyz'[axis]}", "rad", 0.0, pose[:, axis])
    for axis in range(3):
        stated = float(setup.cam_from_screen.translation_m[axis])
        yield from one(f"screen position {'xyz'[axis]}", "m", stated, pose[:, 3 + axis])
    camera = np.array([step.camera for step in steps]).reshape(-1, 10)
    for number, (name, stated) in enumerate(zip(PARAMETER_NAMES, setup.camera.parameters.tolist(), strict=True)):
        unit = "px" if name.endswith("_px") else ""
        words = name.removesuffix("_px").replace("focal", "focal length").replace("center", "principal point")
        yield from one(f"camera {words.replace('_', ' in ')}", unit, stated, camera[:, number])


def _sizes_m(setup: Setup) -> FloatArray:
    """Return width and height of the displayed image along its middle lines."""
    ends = setup.screen.points_m(np.array([0.0, 1.0, 0.5, 0.5]), np.array([0.5, 0.5, 0.0, 1.0]))
    return np.asarray(np.linalg.norm(ends[[1, 3]] - ends[[0, 2]], axis=1))


def words_of_setup(parameters: Sequence[SetupParameter]) -> str:
    """Say which parameters the poses determine, and which keep what was stated."""
    determined = [one.name for one in parameters if one.determined_share >= LEAST_DETERMINED]
    kept = [one.name for one in parameters if one.determined_share < LEAST_DETERMINED]
    said = f"determined by the poses: {', '.join(determined) or 'none'}"
    return f"{said}; not determined, as stated: {', '.join(kept)}" if kept else said
