"""How the mirror's mean normal leans, by the light and by its points in the images: they tell where the sun stood."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from deflectometry.field.placement import IMPOSSIBLE_SIGMAS, OrientedCamera, field_from_mirror, orient_camera
from deflectometry.gazing.keys import GazingMeasurement, GazingModel
from deflectometry.gazing.pipeline.result import Pointing
from deflectometry.pipeline.inputs import build_camera
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray

#: A lean beyond so many sigma is not its scatter: 1 of 270,000 in two directions.
_WRONG_POINTING = 5.0
#: The sun on the equator of the sky; elsewhere it is slower.
_SUN_RAD_PER_S = 2 * np.pi / 86400
#: Slopes that a wrong sun makes wrong by more cannot be stated: the share holds to first order, and the square of a
#: tenth is 1 % of slopes, beyond what a measurement may err by (default of largest_sigma_mrad).
_USELESS_SLOPES = 0.1
#: A lean less sure than this is none: beyond a radian every mirror would be seen from behind.
_LARGEST_SIGMA_RAD = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class PointedByPoints:
    """How the mirror leans against its stated frame, by its points in all images alone.

    lean_rad (2,): Mean slope errors in x and y.
    covariance (2, 2): Theirs, raised by what the points then still miss [rad^2].
    """

    lean_rad: FloatArray
    covariance: FloatArray


def mean_pointing(maps: Mapping[str, SlopeMap]) -> Pointing:
    """Return how the mirror's mean normal leans against the nominal one, weighted by area."""
    total, mean, random, sources = 0, np.zeros(2), np.zeros(2), np.zeros((0, 2))
    for one in maps.values():
        valid = one.valid
        count = int(np.count_nonzero(valid))
        x, y = (grid[valid] for grid in np.meshgrid(one.x_m, one.y_m))
        modes = one.common.evaluate(x, y).sum(axis=2)
        if not sources.size:
            sources = np.zeros(modes.shape)
        total += count
        mean += [float(one.slope_error_x[valid].sum()), float(one.slope_error_y[valid].sum())]
        random += [float((one.sigma_random_x[valid] ** 2).sum()), float((one.sigma_random_y[valid] ** 2).sum())]
        sources = sources + modes
    variance = random / total**2 + ((sources / total) ** 2).sum(axis=0)
    return Pointing(mean / total, np.sqrt(variance), sources / total)


def pointing_by_points(measurement: GazingMeasurement, field_from_stated: RigidTransform) -> PointedByPoints | None:
    """Find how the mirror leans by how narrow and askew its points lie in the images of all cameras.

    field_from_stated: The mirror's frame by its stated place and normal.
    Returns: The lean, or None where points cannot tell: a mirror that is seen from straight in front does not narrow.
    EstimationError: Points that no camera can see at the stated normal and all can at another.

    A mirror that leans stays level in x, as its frame says, and every camera is turned to its points anew.
    """
    from scipy.optimize import least_squares

    model = measurement.model
    cameras = [build_camera(one.camera, measurement.folder) for one in model.camera]

    def seen(lean: FloatArray) -> list[OrientedCamera]:
        normal = field_from_stated.rotate(np.array([-lean[0], -lean[1], 1.0]))
        mirror = field_from_mirror(field_from_stated.translation_m, normal / np.linalg.norm(normal)).inverse()
        return [
            orient_camera(
                section.name,
                camera,
                mirror.apply(np.asarray(section.place_m)),
                np.array([one.point_m for one in section.point]),
                np.array([one.image_px for one in section.point]),
                np.array([one.sigma_px for one in section.point]),
                most_sigmas=float("inf"),
            )
            for section, camera in zip(model.camera, cameras, strict=True)
        ]

    def residuals(lean: FloatArray) -> FloatArray:
        return np.concatenate([one.residual_sigmas.ravel() for one in seen(lean)])

    before = residuals(np.zeros(2))
    freedom = before.size - 3 * len(cameras) - 2
    if freedom < 1:
        return None
    found = least_squares(residuals, np.zeros(2), x_scale=0.01, diff_step=1e-4)
    normal = found.jac.T @ found.jac
    if np.linalg.eigvalsh(normal)[0] < _LARGEST_SIGMA_RAD**-2:
        return None
    covariance = np.linalg.inv(normal) * max(1.0, float(found.fun @ found.fun) / freedom)
    by_points = PointedByPoints(np.asarray(found.x), covariance)
    worst = [float(np.linalg.norm(one.reshape(-1, 2), axis=1).max()) for one in (before, found.fun)]
    if worst[0] >= IMPOSSIBLE_SIGMAS > worst[1]:
        raise EstimationError(_refusal(model, by_points))
    return by_points


def pointing_doubts(
    model: GazingModel, by_light: Pointing, by_points: PointedByPoints | None, sight: FloatArray
) -> Iterator[Doubt]:
    """Yield what contradicts the stated sun, and what a stated normal.

    sight (3,): From the mirror to the cameras, in its frame.
    EstimationError: A sun so far from where the mirror's points put it that slopes beside their mean are useless.

    The light says how the mirror leans if the sun is where it is said to be; the mirror's points say it without the
    sun. Where the two differ, the sun stood elsewhere, by twice the difference.
    """
    if by_points is not None:
        off = by_light.angle_rad - by_points.lean_rad
        covariance = by_points.covariance + np.diag(by_light.sigma_rad**2)
        sigmas = float(np.sqrt(off @ np.linalg.solve(covariance, off)))
        if sigmas > _WRONG_POINTING:
            light, points = (_unit(np.append(-one, 1.0)) for one in (by_light.angle_rad, by_points.lean_rad))
            lean = float(2 * np.arcsin(0.5 * np.linalg.norm(light - points)))
            said = (
                f"the mirror's points in the images say that its normal is {np.degrees(lean):.2g} deg ({sigmas:.0f} "
                f"sigma) from where sun.azimuth_deg (from north, clockwise) and elevation_deg put it: {_clock(lean)}"
            )
            steep = np.linalg.pinv(_d_sight_d_slope(by_light.angle_rad, sight))
            wrong = float(np.linalg.norm(steep @ _d_sight_d_slope(by_points.lean_rad, sight) - np.eye(2), 2))
            if wrong > _USELESS_SLOPES:
                raise EstimationError(f"{said}; slopes beside their mean would be wrong by {100 * wrong:.0f} %")
            yield Doubt(
                "sun_contradicts_points",
                f"{said}; slopes beside their mean are wrong by up to {100 * wrong:.2g} %",
                {"lean_rad": lean, "lean_in_sigmas_ratio": sigmas, "slopes_wrong_share": wrong},
                Severity.SERIOUS,
            )
            return
    sigmas = float(np.hypot(*(by_light.angle_rad / by_light.sigma_rad)))
    # A frame that aims the stated sun turns with it, so that nothing can show and nothing is wrong.
    if model.mirror.aim_m is not None or sigmas < _WRONG_POINTING:
        return
    lean = float(np.hypot(*by_light.angle_rad))
    yield Doubt(
        "pointing_off_stated_normal",
        f"the mean normal leans by {1e3 * lean:.3g} mrad ({sigmas:.0f} sigma) against mirror.normal: the heliostat "
        "points so, its normal is not as stated, or the sun stood elsewhere than sun.azimuth_deg and elevation_deg say "
        f"({_clock(lean)}); slopes beside their mean stay",
        {"lean_rad": lean, "lean_in_sigmas_ratio": sigmas},
        Severity.NOTE,
    )


def _clock(lean_rad: float) -> str:
    """Say by how much a clock must be wrong to turn the normal so: the sun goes twice as far."""
    minutes = 2 * lean_rad / _SUN_RAD_PER_S / 60
    time = f"{minutes:.2g} minutes" if minutes < 90 else f"{minutes / 60:.2g} hours"
    zone = ", such as the wrong time zone" if minutes > 20 else ""
    return f"a clock that is {time} wrong or more moves the sun so far{zone}"


def _d_sight_d_slope(slopes: FloatArray, sight: FloatArray) -> FloatArray:
    """Return by how much a sight turns that still ends in the same point of the sun, for each slope, shape (3, 2).

    Cameras beside each other measure slopes by such turns; what they make of the same light with the normal at other
    slopes is another slope.
    """
    steep = np.append(-slopes, 1.0)
    normal = _unit(steep)
    across = np.eye(3) - np.outer(normal, normal)
    d_normal = -across[:, :2] / np.linalg.norm(steep)
    d_reflected = 2 * (np.outer(normal, sight @ d_normal) + (normal @ sight) * d_normal)
    return np.asarray((2 * np.outer(normal, normal) - np.eye(3)) @ d_reflected)


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector))


def _refusal(model: GazingModel, by_points: PointedByPoints) -> str:
    lean = float(np.hypot(*by_points.lean_rad))
    along = by_points.lean_rad / lean
    sigma = float(np.sqrt(along @ by_points.covariance @ along))
    turn = f"{np.degrees(lean):.2g} deg (sigma {np.degrees(sigma):.1g})"
    stated, why = (
        ("mirror.normal says", "the heliostat pointed elsewhere")
        if model.mirror.aim_m is None
        else (
            "mirror.aim_m and the sun's direction say",
            f"check sun.azimuth_deg and elevation_deg ({_clock(lean)}), aim_m, and whether the heliostat tracked",
        )
    )
    return f"its points in the images of all cameras say that the mirror is turned by {turn} from where {stated}: {why}"
