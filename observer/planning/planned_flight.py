"""Where a planned pass takes its photos, and what of the mirror it cannot show."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray
from observer.product.figures_of_merit import reach_needed_m
from observer.trough.collector import Collector
from observer.trough.visibility import WORTH_SAYING_SHARE, beyond_tube_text

#: Where cameras look: between vertex and rim of a usual trough [m].
_LOOK_AT_Z_M = 0.6
#: Paths are flown to some centimetres [m].
_CLOSE_M = 0.05
#: Mirrors of a typical slope error have parts of three times that.
_REACH_TIMES = 3.0


@dataclass(frozen=True, slots=True)
class Pass:
    """Photos across the aperture.

    height_m: Height of the camera above the vertex [m].
    reach_m: Photos from x = -reach to +reach [m].
    photos: How many, evenly spaced.
    y_m: Where along the trough the camera is [m].
    look_y_m: Where along the trough it looks [m].
    InputError: Fewer than two photos, or a camera that is not above the collector.
    """

    height_m: float
    reach_m: float
    photos: int
    y_m: float = 0.0
    look_y_m: float = 0.0

    def __post_init__(self) -> None:
        if self.photos < 2 or self.height_m <= _LOOK_AT_Z_M or self.reach_m <= 0:
            raise InputError(
                f"pass: {self.photos} photos from {self.height_m:g} m with a reach of {self.reach_m:g} m; two photos, "
                f"a height above {_LOOK_AT_Z_M:g} m and a reach above 0 are needed"
            )

    def poses(self) -> tuple[RigidTransform, ...]:
        """Return ``cam_from_frame`` of all photos; the image's x axis lies along the trough."""
        aim = np.array([0.0, self.look_y_m, _LOOK_AT_Z_M])
        across = np.linspace(-self.reach_m, self.reach_m, self.photos)
        return tuple(_looking(np.array([x, self.y_m, self.height_m]), aim) for x in across)


def _looking(eye_m: FloatArray, aim_m: FloatArray) -> RigidTransform:
    forward = (aim_m - eye_m) / np.linalg.norm(aim_m - eye_m)
    down = np.cross(forward, [0.0, 1.0, 0.0])
    if float(np.linalg.norm(down)) < 1e-3:
        raise InputError("pass: a camera looks along the trough; move it or where it looks")
    down /= np.linalg.norm(down)
    rotation = np.stack([np.cross(down, forward), down, forward])
    return RigidTransform(rotation, -rotation @ eye_m)


def advice(
    collector: Collector, passes: tuple[Pass, ...], shares: dict[SampleFlag, float], slope_error_rad: float
) -> Iterator[Doubt]:
    """Yield where to fly for what is missing.

    shares: Share of the mirror that is not measured, by reason.
    slope_error_rad: RMS slope error of the mirror that is expected [rad].
    """
    for one in passes:
        needed = reach_needed_m(collector, one.height_m, _REACH_TIMES * slope_error_rad)
        if one.reach_m < needed - _CLOSE_M:
            yield Doubt(
                "plan_pass_too_short",
                f"pass at y = {one.y_m:g} m: photos from x = {-one.reach_m:g} to {one.reach_m:g} m; for both edges of "
                f"the reflection on the whole aperture fly from {-needed:.2f} to {needed:.2f} m at this height",
                {"reach_m": one.reach_m, "needed_m": needed},
            )
    share = shares.get(SampleFlag.BEYOND_TUBE, 0.0)
    if share > WORTH_SAYING_SHARE:
        text = beyond_tube_text(share, collector, min(one.height_m for one in passes))
        yield Doubt("plan_beyond_tube", text, {"missing_share": share})
    share = shares.get(SampleFlag.BEHIND_TUBE, 0.0)
    if share > WORTH_SAYING_SHARE:
        yield Doubt(
            "plan_behind_receiver",
            f"{100 * share:.1f} % of the mirror lies behind the receiver whenever it would show the tube; no pass of a "
            "small camera changes that",
            {"missing_share": share},
        )


def steps_too_wide(passes: tuple[Pass, ...]) -> Iterator[Doubt]:
    """Yield passes with photos so far apart that a part of the mirror lies between their samples."""
    for one in passes:
        step = 2 * one.reach_m / (one.photos - 1)
        if step > 0.2:
            wanted = int(np.ceil(2 * one.reach_m / 0.06)) + 1
            yield Doubt(
                "plan_photos_far_apart",
                f"pass at y = {one.y_m:g} m: photos {1e3 * step:.0f} mm apart sample the mirror as coarsely; {wanted} "
                "photos would be 60 mm apart",
                {"step_m": step, "wanted_count": wanted},
            )
