"""What each pixel of a facet sees of a source after the mirror."""

from dataclasses import dataclass

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """A flat bright source.

    half_m: Half width and half height of a rectangle; radius of a disc twice [m].
    is_disc: Whether it is a disc.
    heliostat_from_source: Its place: origin in its middle, x and y in its plane.
    """

    half_m: tuple[float, float]
    is_disc: bool
    heliostat_from_source: RigidTransform

    def brightness(self, places_m: FloatArray, blur_m: float) -> FloatArray:
        """Return the share of light that blurred places see of it, 0 to 1.

        places_m (2, n): In its plane [m].
        blur_m: Standard deviation of the blur in its plane [m].
        """
        from scipy.special import ndtr

        if self.is_disc:
            return np.asarray(ndtr((self.half_m[0] - np.hypot(*places_m)) / blur_m))
        shares = [
            ndtr((half + one) / blur_m) - ndtr((one - half) / blur_m)
            for half, one in zip(self.half_m, places_m, strict=True)
        ]
        return np.asarray(shares[0] * shares[1])


@dataclass(frozen=True, slots=True, eq=False)
class FacetPixels:
    """Pixels of one facet in one photo.

    pixels_px (n, 2): Their places [px].
    origin_m (3,), rays (n, 3): Camera and lines of sight in the facet's frame.
    facet_from_heliostat: Into that frame.
    """

    pixels_px: FloatArray
    origin_m: FloatArray
    rays: FloatArray
    facet_from_heliostat: RigidTransform

    @classmethod
    def of(
        cls, camera: Camera, cam_from_heliostat: RigidTransform, facet: Facet, pixels_px: FloatArray
    ) -> "FacetPixels":
        """Return the lines of sight of pixels in the frame of a facet."""
        facet_from_heliostat = facet.ensemble_from_facet.inverse()
        facet_from_cam = facet_from_heliostat @ cam_from_heliostat.inverse()
        rays = facet_from_cam.rotate(camera.cast_rays(pixels_px))
        return cls(pixels_px, facet_from_cam.translation_m, rays, facet_from_heliostat)


def turned_about(point_m: FloatArray, turn_rad: FloatArray) -> RigidTransform:
    """Return the motion that turns a facet about a point so that its slopes grow by a turn.

    point_m (3,): The point, facet frame [m].
    turn_rad (2,): Positive where the surface then rises more towards +x and +y [rad].
    """
    turn = RigidTransform.from_rotation_vector((turn_rad[1], -turn_rad[0], 0.0), (0.0, 0.0, 0.0))
    return RigidTransform(turn.rotation, point_m - turn.rotation @ point_m)


def seen_places(pixels: FacetPixels, facet: Facet, turn_rad: FloatArray, source: Source) -> FloatArray:
    """Return where in the source's plane each pixel looks after the mirror, shape (2, n) [m]; NaN where it does not.

    turn_rad (2,): Turn of the facet about its reference point against its design [rad].
    """
    x, y = facet.reference_point_m
    about = np.array([x, y, float(facet.design.height(x, y))])
    surface = facet.design.transformed(turned_about(about, turn_rad))
    points = pixels.origin_m + surface.intersect(pixels.origin_m, pixels.rays)[:, None] * pixels.rays
    slope_x, slope_y = surface.gradient(points[:, 0], points[:, 1])
    normals = np.stack([-slope_x, -slope_y, np.ones(len(points))], axis=-1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    beams = pixels.rays - 2 * np.sum(pixels.rays * normals, axis=1, keepdims=True) * normals
    source_from_facet = source.heliostat_from_source.inverse() @ pixels.facet_from_heliostat.inverse()
    start, along = source_from_facet.apply(points), source_from_facet.rotate(beams)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = -start[:, 2] / along[:, 2]
        places = start[:, :2] + reach[:, None] * along[:, :2]
    return np.where(reach > 0, places.T, np.nan)


def outline_px(camera: Camera, cam_from_heliostat: RigidTransform, facet: Facet, per_side: int = 8) -> FloatArray:
    """Return a facet's outline in a photo, shape (n, 2) [px]."""
    corners = facet.outline_m
    share = np.arange(per_side) / per_side
    along = np.concatenate(
        [a + share[:, None] * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    )
    points = np.column_stack([along, facet.design.height(along[:, 0], along[:, 1])])
    return camera.project((cam_from_heliostat @ facet.ensemble_from_facet).apply(points))
