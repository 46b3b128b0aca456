"""The file of a measured screen: its points, what they share, and the pose of the measuring camera."""

from pathlib import Path
from typing import Any

import numpy as np

from deflectometry.screen_geometry.measured_screen import MeasuredScreen
from deflectometry.setup.dot_screen import DotScreen
from deflectometry.setup.smooth_screen import SharedStep, SmoothScreen, SmoothWarp, degree_of, terms_of
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.arrays import LabelledArray, read_arrays, write_arrays

#: Name of the file in a folder of results.
SCREEN_FILE = "screen.nc"
_SHARED = ("shared_coefficients_m", "shared_pose_steps")


def write_screen(path: Path, measured: MeasuredScreen, name: str) -> None:
    """Write a measured screen."""
    screen = measured.screen
    attributes: dict[str, Any] = {"name": name, "sigma_surface_m": measured.sigma_surface_m}
    if isinstance(screen, DotScreen):
        attributes |= {"form": "dots", "first_column": screen.first[0], "first_row": screen.first[1]}
        own = np.zeros(screen.xyz_m.shape) if screen.sigma_m is None else screen.sigma_m
        by_dot = ("row", "column", "axis")
        arrays = [
            LabelledArray("dots_m", by_dot, screen.xyz_m, "m", "place of each dot in the screen's frame"),
            LabelledArray("sigma_dots_m", by_dot, own, "m", "standard deviation that is each dot's own"),
        ]
    else:
        reach = {"measured_u": list(screen.measured_u), "measured_v": list(screen.measured_v)}
        attributes |= {"form": screen.form, **reach}
        words = "coefficients of the monomials of u and v from -1 to 1 over the displayed image"
        arrays = [LabelledArray("surface_m", ("term", "axis"), screen.coefficients, "m", words)]
    if measured.cam_from_screen is not None:
        pose = measured.cam_from_screen
        attributes |= {
            "rotation_vector_rad": pose.rotation_vector_rad.tolist(),
            "translation_m": pose.translation_m.tolist(),
        }
    warps = np.array([one.warp.coefficients for one in measured.shared])
    steps = np.array([one.cam_from_screen for one in measured.shared])
    arrays += [
        LabelledArray(_SHARED[0], ("error", "shared_term", "axis"), warps, "m", "independent errors of the points"),
        LabelledArray(_SHARED[1], ("error", "step"), steps, "rad, m", "the same errors of cam_from_screen"),
    ]
    axes = dict.fromkeys(axis for one in arrays for axis in one.axes)
    sizes = {axis: one.values.shape[k] for one in arrays for k, axis in enumerate(one.axes)}
    numbered = [LabelledArray(axis, (axis,), np.arange(sizes[axis]), "1", f"number of the {axis}") for axis in axes]
    write_arrays(path, [*numbered, *arrays], attributes)


def read_screen(path: Path) -> MeasuredScreen:
    """Read a measured screen.

    Parameters
    ----------
    path : Path
        The file ``screen.nc``, or the folder of results with it.

    Returns
    -------
    MeasuredScreen
        The screen with its shared errors.

    Raises
    ------
    InputError
        No such file, or another one.
    """
    path = path / SCREEN_FILE if path.is_dir() else path
    arrays, attributes = read_arrays(path, _SHARED)
    try:
        warps, steps = (np.asarray(arrays[name], dtype=np.float64) for name in _SHARED)
        if attributes["form"] == "dots":
            first = (int(attributes["first_column"]), int(attributes["first_row"]))
            screen: DotScreen | SmoothScreen = DotScreen(
                np.asarray(arrays["dots_m"], dtype=np.float64),
                first,
                np.asarray(arrays["sigma_dots_m"], dtype=np.float64),
            )
        else:
            reach = [tuple(float(one) for one in attributes[name]) for name in ("measured_u", "measured_v")]
            surface = np.asarray(arrays["surface_m"], dtype=np.float64)
            if surface.shape != (terms_of(degree_of(len(surface))), 3):
                raise InputError(f"{path}: surface_m has shape {surface.shape}, which no polynomial has")
            screen = SmoothScreen(
                surface, (reach[0][0], reach[0][1]), (reach[1][0], reach[1][1]), str(attributes["form"])
            )
        pose = None
        if "translation_m" in attributes:
            pose = RigidTransform.from_rotation_vector(
                np.asarray(attributes["rotation_vector_rad"]), np.asarray(attributes["translation_m"])
            )
        sigma = float(attributes.get("sigma_surface_m", 0.0))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: not a measured screen ({error!r}); `heliogauge deflectometry screen geometry` writes screen.nc"
        ) from None
    shared = tuple(SharedStep(step, SmoothWarp(warp)) for step, warp in zip(steps, warps, strict=True))
    return MeasuredScreen(screen, shared, pose, sigma)
