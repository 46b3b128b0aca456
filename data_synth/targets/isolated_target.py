"""One target by itself, at a given size, tilt, noise and background slope: what a centre operator is measured with."""

from dataclasses import dataclass, replace

import numpy as np

from data_synth.optics.photo import View, draw_sheets
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.prints import DotPrint, RingPrint
from data_synth.optics.sheets import Sheet
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import Float32Array, FloatArray, freeze, positive
from photogrammetry.targets import RingCode

#: The lens of all isolated targets: 12 px of dot are 20 mm at 5 m.
_FOCAL_PX = 3000.0
_DISTANCE_M = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class IsolatedTarget(ShortRepr):
    """How one target is photographed.

    diameter_px: Largest diameter of the dot's image [px].
    tilt_rad: Angle between the target's normal and the line of sight [rad].
    azimuth_rad: Direction of the tilt in the image [rad].
    signal_to_noise: Contrast between ink and paper over the noise of a pixel.
    slope_dn_per_px: Change of the background with x and y [DN/px].
    blur_sigma_px: Gaussian blur of the lens [px].
    code: A code ring; a plain dot without.
    contrast_dn: Paper minus ink; negative for light on dark [DN].

    The paper fills the image, so that only the dot (and its ring) has edges.
    """

    diameter_px: float
    tilt_rad: float = 0.0
    azimuth_rad: float = 0.0
    signal_to_noise: float = 200.0
    slope_dn_per_px: tuple[float, float] = (0.0, 0.0)
    blur_sigma_px: float = 0.5
    code: RingCode | None = None
    contrast_dn: float = 180.0

    @property
    def side_px(self) -> int:
        """Side of the image: the ring and as much again, 24 px at least [px]."""
        reach = 3.0 if self.code is not None else 1.0
        return max(int(np.ceil(self.diameter_px * reach * 1.3)) + 14, 24)


@dataclass(frozen=True, slots=True, eq=False)
class IsolatedImage:
    """An image of one target with its truth.

    image_dn (h, w): The image, not rounded [DN].
    center_px (2,): Projection of the target's centre [px].
    noise_dn: Noise of each pixel [DN].
    view: The camera.
    """

    image_dn: Float32Array
    center_px: FloatArray
    noise_dn: float
    view: View
    sheet: Sheet


def draw_isolated(target: IsolatedTarget, rng: np.random.Generator, *, turn_rad: float = 0.0) -> IsolatedImage:
    """Draw one target with its centre anywhere within the middle pixel, and noise.

    turn_rad: Turn of the target about its normal [rad].
    """
    side = target.side_px
    middle = (side - 1) / 2
    camera = PinholeCamera(side, side, _FOCAL_PX, _FOCAL_PX, middle, middle)
    view = View("isolated", camera, RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, _DISTANCE_M])))
    offset = rng.uniform(-0.5, 0.5, 2) * _DISTANCE_M / _FOCAL_PX
    axis = np.array([-np.sin(target.azimuth_rad), np.cos(target.azimuth_rad), 0.0]) * target.tilt_rad
    rotation = rotation_from_vector(axis) @ rotation_from_vector(np.array([0.0, 0.0, turn_rad]))
    diameter = positive("diameter_px", target.diameter_px, "px") * _DISTANCE_M / _FOCAL_PX
    figure = DotPrint(diameter) if target.code is None else RingPrint(target.code, diameter)
    place = RigidTransform(rotation, np.array([*offset, 0.0]))
    sheet = Sheet("target", figure, place, ink=1.0, paper=0.0, transparent=True)
    ink = np.zeros((side, side), dtype=np.float32)
    draw_sheets(ink, view, [sheet], target.blur_sigma_px)
    step = np.arange(side, dtype=np.float32) - np.float32(middle)
    slope_x, slope_y = (np.float32(part) for part in target.slope_dn_per_px)
    paper = np.float32(128 + target.contrast_dn / 2) + slope_y * step[:, None] + slope_x * step[None, :]
    noise = abs(target.contrast_dn) / target.signal_to_noise
    image = paper - np.float32(target.contrast_dn) * ink
    image += np.float32(noise) * rng.standard_normal(ink.shape, dtype=np.float32)
    return IsolatedImage(
        freeze(image), view.project(place.translation_m), noise, view, replace(sheet, transparent=False)
    )
