"""Cameras that the light puts elsewhere than their stated places."""

from collections.abc import Iterator, Sequence

import numpy as np

from deflectometry.gazing.camera_gains import Gains
from heliogauge.doubts import Doubt, Severity
from heliogauge.validate import FloatArray

#: A place beyond so many sigma is not its scatter: 1 of 270,000 in two directions.
_WRONG_PLACE = 5.0
#: Cameras whose statistic is lower by less fit as well: chi-square of 2 e-fold probabilities each.
_AS_LIKELY = 4.0


def place_doubts(names: Sequence[str], gains: Gains, places: FloatArray) -> Iterator[Doubt]:
    """Yield a doubt where one camera that stands elsewhere explains the adjusted places.

    names: Of the cameras in the adjustment.
    places (c, c): Covariance of each coordinate of their places before [m^2].

    An adjusted place goes only a part of the way, and takes the others along. How far a camera stands off if it alone
    does, and how sure that is, follow from all of them (data snooping, Baarda 1968, A testing procedure for use in
    geodetic networks; here of two coordinates together).
    """
    count = len(names)
    inverse = np.kron(np.eye(2), np.linalg.inv(places + 1e-12 * np.eye(count)))
    after = (gains.covariance + gains.by_profile @ gains.by_profile.T)[count:, count:]
    pull = inverse @ gains.shift_m.T.ravel()
    known = inverse - inverse @ after @ inverse
    off, sigmas = np.empty((count, 2)), np.empty(count)
    for number in range(count):
        own = [number, count + number]
        off[number] = np.linalg.solve(known[np.ix_(own, own)], pull[own])
        sigmas[number] = np.sqrt(max(float(off[number] @ pull[own]), 0.0))
    worst = int(np.argmax(sigmas))
    if sigmas[worst] < _WRONG_PLACE:
        return
    likely = [number for number in np.argsort(-sigmas) if sigmas[number] ** 2 > sigmas[worst] ** 2 - _AS_LIKELY]
    said = ", or ".join(
        f"{names[number]} stands {1e3 * off[number, 0]:.2g} mm in x and {1e3 * off[number, 1]:.2g} mm in y of the "
        f"mirror from its place_m ({sigmas[number]:.0f} sigma)"
        for number in likely
    )
    yield Doubt(
        "camera_stands_elsewhere",
        f"by the light in the mirror {said}; slopes follow the stated places: check place_m and sigma_place_mm of all "
        "cameras, and sun.focal_px",
        {"place_off_m": float(np.linalg.norm(off[worst])), "place_in_sigmas_ratio": float(sigmas[worst])},
        Severity.SERIOUS,
    )
