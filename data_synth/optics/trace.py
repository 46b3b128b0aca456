"""Rays of the synthetic camera: over the true surface of a facet to the wall, all in closed form or by Newton."""

from dataclasses import dataclass

import numpy as np

from data_synth.optics.mirror import SyntheticFacet, reflect
from data_synth.optics.pinhole import PinholeCamera
from data_synth.optics.wall import Wall
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Traced:
    """Where rays met the mirror and the wall.

    points_m (..., 3): Points on the true surface, in the facet's frame, also beyond its outline [m].
    slope_x, slope_y (...): True slopes there [rad].
    u, v (...): Display coordinates; outside 0..1 beyond the image, NaN where the ray leaves the wall.
    """

    points_m: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    u: FloatArray
    v: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """Camera, mirror and wall as they really stand.

    cam_from_mirror: Mirror frame to camera frame.
    wall: The screen.
    cam_from_wall: Screen frame to camera frame.
    """

    camera: PinholeCamera
    cam_from_mirror: RigidTransform
    wall: Wall
    cam_from_wall: RigidTransform

    def trace(self, facet: SyntheticFacet, x_px: FloatArray, y_px: FloatArray) -> Traced:
        """Follow the line of sight of image points over a facet to the wall.

        Shapes: x_px, y_px (...).
        facet: The facet, continued beyond its outline.
        """
        cam_from_facet = self.cam_from_mirror @ facet.mirror_from_facet
        facet_from_cam = cam_from_facet.inverse()
        directions = facet_from_cam.rotate(self.camera.rays(x_px, y_px))
        points, slope_x, slope_y = facet.intersect(facet_from_cam.translation_m, directions)
        wall_from_facet = self.cam_from_wall.inverse() @ cam_from_facet
        seen = self.wall.hit(
            wall_from_facet.apply(points), wall_from_facet.rotate(reflect(directions, slope_x, slope_y))
        )
        return Traced(points, slope_x, slope_y, *self.wall.display_coordinates(seen))

    def project_outline(self, facet: SyntheticFacet, points_per_edge: int = 32) -> FloatArray:
        """Return where the facet's outline appears in the image.

        Shapes: result (n_corners * points_per_edge, 2).
        points_per_edge: Points on each edge, its first corner included.
        """
        share = np.arange(points_per_edge)[:, None] / points_per_edge
        ends = np.roll(facet.outline_m, -1, axis=0)
        rim = np.concatenate([a + share * (b - a) for a, b in zip(facet.outline_m, ends, strict=True)])
        height = facet.surface(rim[:, 0], rim[:, 1])[0]
        cam_from_facet = self.cam_from_mirror @ facet.mirror_from_facet
        return self.camera.project(cam_from_facet.apply(np.column_stack([rim, height])))
