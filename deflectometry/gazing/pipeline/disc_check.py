"""Whether all cameras say the same size of the sun: its profile scales every slope."""

from collections.abc import Iterator, Sequence

import numpy as np

from deflectometry.field.placement import OrientedCamera
from deflectometry.gazing.keys import SunCameraSection
from deflectometry.gazing.pipeline.inputs import GazingCamera
from deflectometry.gazing.sun_profile import SunImage
from heliogauge.doubts import Doubt, Severity

#: A difference beyond so many sigma is not its scatter: 1 of 10^6 Gaussian ones.
_OTHER_DISC = 5.0


def disc_doubts(section: SunCameraSection, of_sun: SunImage, cameras: Sequence[GazingCamera]) -> Iterator[Doubt]:
    """Yield a doubt where focal_px of the camera on the sun makes another disc than the other cameras' images of it.

    Points of the mirror check the other cameras' focal lengths, as well as the points are measured: so uncertain they
    count.
    """
    own = np.array([one.sun.profile.radius_rad for one in cameras])
    variance = [
        (one.sun.sigma_radius_rad / one.sun.profile.radius_rad) ** 2 + _sigma_scale(one.oriented) ** 2
        for one in cameras
    ]
    weight = 1.0 / np.array(variance)
    by_cameras = float(own @ weight / weight.sum())
    here = of_sun.profile.radius_rad
    off = here / by_cameras - 1.0
    noise = np.hypot(of_sun.sigma_radius_rad / here, weight.sum() ** -0.5)
    sigmas = abs(off) / float(np.hypot(noise, 1e-3 * section.sigma_focal_permille))
    if sigmas < _OTHER_DISC:
        return
    asked = section.focal_px * here / by_cameras
    yield Doubt(
        "sun_of_another_size",
        f"by sun.focal_px = {section.focal_px:.5g} the sun's disc is {2e3 * here:.4g} mrad across, in the cameras' own "
        f"images of it {2e3 * by_cameras:.4g} mrad ({sigmas:.0f} sigma): they ask for focal_px = {asked:.5g} (sigma "
        f"{asked * float(noise):.2g}); all slopes beside their mean are {abs(100 * off):.2g} % too "
        f"{'large' if off > 0 else 'small'}, or the cameras' own focal lengths are wrong by that",
        {"focal_asked_px": asked, "size_ratio": 1.0 + off, "size_in_sigmas_ratio": sigmas},
        Severity.SERIOUS,
    )


def _sigma_scale(camera: OrientedCamera) -> float:
    """Return how well points of the mirror check a camera's focal length, relative.

    A turn about an axis in the image moves a point by the focal length, one about the sight by its distance from the
    middle of the points: as much as another focal length does.
    """
    return float(np.sqrt(camera.covariance_turn[2, 2]))
