"""A photographed trough: collector, surroundings, targets, photos, lens and sensor."""

from dataclasses import dataclass, field, replace

import numpy as np

from data_synth.optics.photo import View
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.sensor import Sensor
from data_synth.optics.sheets import Sheet
from data_synth.optics.surface_errors import SurfaceErrors
from data_synth.targets.scene import sheet_points
from data_synth.troughs.mirror import SlopeGrid, TroughMirror
from data_synth.troughs.receiver import Receiver
from data_synth.troughs.surroundings import Surroundings
from data_synth.troughs.trace import Finish, TroughWorld
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray, float_array, positive
from observer.trough import Collector


@dataclass(frozen=True, slots=True, eq=False)
class RollingShutter:
    """A sensor that reads its rows one after the other while the camera moves.

    readout_s: From the first row to the last [s].
    velocity_m_s (3,): Motion of the camera in the trough's frame [m/s].
    turn_rad_s (3,): Rotation vector of the camera per second, in its own frame [rad/s].
    """

    readout_s: float
    velocity_m_s: FloatArray
    turn_rad_s: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        positive("rolling shutter readout_s", self.readout_s, "seconds")
        for name in ("velocity_m_s", "turn_rad_s"):
            object.__setattr__(self, name, float_array(f"rolling shutter {name}", getattr(self, name), (3,)))


@dataclass(frozen=True, slots=True, eq=False)
class TroughView:
    """One photo of a trough.

    cam_from_trough: Trough frame to camera frame, while the middle row is read.
    exposure: Exposure relative to the others.
    shutter: How rows follow each other; all at once without.
    orientation_deg: Turn of the collector from zenith, where it differs from photo to photo [deg].
    purpose: What it is taken for: ``reflection``, or ``absorber`` for the absorber's position alone.
    """

    name: str
    camera: PinholeCamera
    cam_from_trough: RigidTransform
    exposure: float = 1.0
    shutter: RollingShutter | None = None
    orientation_deg: float | None = None
    purpose: str = "reflection"

    @property
    def position_m(self) -> FloatArray:
        """The camera in the trough's frame while the middle row is read, shape (3,) [m]."""
        return self.cam_from_trough.inverse().translation_m

    def at_row(self, row: float) -> View:
        """Return camera and pose while a row is read."""
        return View(self.name, self.camera, self.pose_at(row))

    def pose_at(self, row: float) -> RigidTransform:
        """Return ``cam_from_trough`` while a row is read."""
        if self.shutter is None:
            return self.cam_from_trough
        share = (row - (self.camera.height_px - 1) / 2) / self.camera.height_px
        after_s = share * self.shutter.readout_s
        turn = RigidTransform.from_rotation_vector(self.shutter.turn_rad_s * after_s, np.zeros(3)).inverse()
        rotation = turn.rotation @ self.cam_from_trough.rotation
        position = self.position_m + self.shutter.velocity_m_s * after_s
        return RigidTransform(rotation, -rotation @ position)

    def project(self, points_m: FloatArray) -> FloatArray:
        """Return image points, each taken while its own row is read.

        points_m (n, 3): Points in the trough's frame [m].
        Returns (n, 2): Image points; NaN behind the camera [px].
        """
        pixels = self.at_row((self.camera.height_px - 1) / 2).project(points_m)
        if self.shutter is None:
            return pixels
        # A row moves the image by less than a hundredth of a row: each round gains two digits.
        for _ in range(6):
            pixels = np.array(
                [self.at_row(pixel[1]).project(point) for pixel, point in zip(pixels, points_m, strict=True)]
            )
        return pixels


@dataclass(frozen=True, slots=True, eq=False)
class ListedTarget:
    """A target as the list of the person who measures has it.

    stated_m (3,): Its coordinates as known [m].
    sigma_m (3,): Their standard deviations; NaN: unknown [m].
    on_collector: Whether it turns with the collector.
    kind: What it looks like: coded, plain or square.
    code: What photos show it as.
    diameter_m: Diameter of its dot; None for a corner of a square marker [m].
    """

    name: str
    stated_m: FloatArray
    sigma_m: FloatArray
    on_collector: bool = True
    kind: str = "coded"
    code: str = ""
    diameter_m: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "stated_m", float_array("target stated_m", self.stated_m, (3,)))
        object.__setattr__(self, "sigma_m", float_array("target sigma_m", self.sigma_m, (3,), finite=False))


@dataclass(frozen=True, slots=True)
class Optics:
    """Lens and sensor.

    blur_sigma_px: Gaussian blur of the lens [px].
    vignetting: Loss of light in the corners.
    """

    blur_sigma_px: float = 0.6
    vignetting: float = 0.12
    sensor: Sensor = field(default_factory=lambda: Sensor(exposure=0.85, read_noise_dn=0.8, shot_gain_dn=0.01))


@dataclass(frozen=True, slots=True, eq=False)
class PlacedTrough:
    """A trough among others.

    world: Collector and surroundings.
    place_m (3,): Its origin in the common frame, to whose axes its own are parallel [m].
    """

    name: str
    world: TroughWorld
    place_m: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "place_m", float_array(f"trough {self.name} place_m", self.place_m, (3,)))


@dataclass(frozen=True, slots=True, eq=False)
class TroughScene:
    """A trough, or several, and the photos of it.

    name: Name of the measurement.
    world: Collector and surroundings.
    views: The photos, all by one camera.
    sheets: Printed targets.
    targets: The list of targets as the person who measures has it.
    optics: Lens and sensor.
    dictionary: Name of the targets' dictionary, or ``circles``.
    target_diameter_m: Diameter of the dots, or side of square markers [m].
    troughs: Several troughs in one frame, that of views, sheets and targets; `world` is then the first one's.
    has_tube_beside: Whether photos show the tube beside its own reflection, so that its place is measured in them.
    InputError: No photo, or photos by different cameras.
    """

    name: str
    world: TroughWorld
    views: tuple[TroughView, ...]
    sheets: tuple[Sheet, ...]
    targets: tuple[ListedTarget, ...]
    optics: Optics = field(default_factory=Optics)
    dictionary: str = "aicon-12"
    target_diameter_m: float = 0.06
    troughs: tuple[PlacedTrough, ...] = ()
    has_tube_beside: bool = True

    def __post_init__(self) -> None:
        if not self.views:
            raise InputError(f"scene {self.name}: at least one photo is needed")
        if any(view.camera is not self.views[0].camera for view in self.views):
            raise InputError(f"scene {self.name}: all photos must be by one camera")

    @property
    def collector(self) -> Collector:
        """The design."""
        return self.world.mirror.collector

    @property
    def camera(self) -> PinholeCamera:
        """The camera."""
        return self.views[0].camera

    def scaled(self, factor: float) -> "TroughScene":
        """Return the scene with finer or coarser pixels; the blur stays the same in metres on the sensor.

        factor: Pixels per old pixel.
        """
        camera = self.camera.scaled(factor)
        optics = replace(self.optics, blur_sigma_px=self.optics.blur_sigma_px * factor)
        return replace(self, views=tuple(replace(view, camera=camera) for view in self.views), optics=optics)

    def with_optics(self, *, read_noise_dn: float | None = None, blur_sigma_px: float | None = None) -> "TroughScene":
        """Return the scene with another noise or lens.

        read_noise_dn: Noise of each pixel; the scene's own if absent [DN].
        blur_sigma_px: Gaussian blur of the lens; the scene's own if absent [px].
        """
        optics = self.optics
        if read_noise_dn is not None:
            optics = replace(optics, sensor=replace(optics.sensor, read_noise_dn=read_noise_dn))
        if blur_sigma_px is not None:
            optics = replace(optics, blur_sigma_px=blur_sigma_px)
        return replace(self, optics=optics)

    def with_rolling_shutter(self, readout_s: float, speed_m_s: float = 2.0) -> "TroughScene":
        """Return the scene taken with a rolling shutter while flying from each photo's place to the next one's.

        readout_s: From the first row to the last [s].
        Returns: The scene; the gimbal holds the camera's directions.
        """
        places = np.array([view.position_m for view in self.views])
        step = np.gradient(places, axis=0) if len(places) > 1 else np.array([[1.0, 0.0, 0.0]])
        velocities = speed_m_s * step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12)
        views = tuple(
            replace(view, shutter=RollingShutter(readout_s, velocity))
            for view, velocity in zip(self.views, velocities, strict=True)
        )
        return replace(self, views=views)

    def with_slopes(self, slopes: SlopeGrid) -> "TroughScene":
        """Return the scene with a mirror that has just these errors.

        slopes: Slope errors over the aperture.
        InputError: Several troughs.
        """
        if self.troughs:
            raise InputError(f"scene {self.name}: one map of slopes for {len(self.troughs)} troughs")
        return replace(
            self, world=replace(self.world, mirror=TroughMirror(self.collector, errors=SurfaceErrors((slopes,))))
        )

    def points_m(self) -> dict[str, FloatArray]:
        """Return the true places of all targets, by name, in the trough's frame [m]."""
        return {name: place for sheet in self.sheets for name, place in sheet_points(sheet).items()}

    def surroundings_of(self, view: TroughView) -> Surroundings:
        """Return the surroundings as one photo has them."""
        around = self.world.surroundings
        return around if view.orientation_deg is None else around.turned(view.orientation_deg)


def world_of(
    mirror: TroughMirror,
    receiver: Receiver | None = None,
    surroundings: Surroundings | None = None,
    finish: Finish | None = None,
) -> TroughWorld:
    """Return a world with a receiver in its place and usual surroundings, where nothing else is given.

    surroundings: Sky and ground.
    finish: Brightness of the parts.
    """
    return TroughWorld(
        mirror,
        Receiver(mirror.collector) if receiver is None else receiver,
        Surroundings() if surroundings is None else surroundings,
        Finish() if finish is None else finish,
    )
