"""What the cells of a code do to a whole slope map: neighbouring pixels share their errors."""

from dataclasses import replace

import numpy as np

from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.pixel_slopes import SlopeImage, measure_slopes
from deflectometry.shape.smooth_shape import FittedSurface
from deflectometry.sources.screen_map import ScreenMap
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.slopes.map import CELLS, CommonModes, monomials
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Harmonics of the error within a cell: they hold 6 / pi^2 sum(1 / m^2) = 89 % of its variance.
_HARMONICS = 5
#: Degrees of the polynomials in the pixels that may stand for the display point between the cells: one of fifth degree
#: follows single steps where a cell holds many pixels, one of third degree no more than a bent mirror.
_DEGREES = (3, 4, 5)
#: Step of the display point for the derivative of the slopes by it.
_STEP = 1e-4


def with_cells(
    common: CommonModes,
    setup: Setup,
    screen_map: ScreenMap,
    region: BoolArray,
    cam_from_facet: RigidTransform,
    surface: FittedSurface,
    image: SlopeImage,
) -> CommonModes:
    """Return the common modes of a facet with the smooth share of the errors that come from the cells of a code.

    common: Those without.
    region (h, w): Pixels of the facet.
    image: Its slopes.

    Within a cell of width c the code leaves a display point u open: its error is a sawtooth of u / c, the sum of
    ``c / (pi m) sin(2 pi m (u / c + s))``. Where cells and pixels are nearly as wide, or a cell holds many pixels, it
    varies slowly (a moire) and is no noise of single pixels. Where on the display the cells begin, s, is by chance:
    the cosine and the sine of each harmonic are two modes of amplitude ``c / (sqrt(2) pi m)``. u between the cells is
    a polynomial in the pixels, each of the degrees as likely.
    """
    box = (slice(image.row, image.row + image.x_m.shape[0]), slice(image.column, image.column + image.x_m.shape[1]))
    good = np.isfinite(image.slope_x)
    rows, columns = np.nonzero(good)
    u, v = _centred(columns), _centred(rows)
    candidates = [monomials(u, v, degree) for degree in _DEGREES]
    places = (np.stack([image.x_m[good], image.y_m[good]]) - common.center_m[:, None]) / common.scale_m
    terms = monomials(places[0], places[1], common.degree)
    solver = np.linalg.pinv(terms @ terms.T, rcond=1e-12, hermitian=True) @ terms
    found = []
    for name, cell in zip("uv", screen_map.cells, strict=True):
        if not cell > 0:
            continue
        whole = getattr(screen_map, name)
        moved = measure_slopes(
            setup, replace(screen_map, **{name: whole + np.float32(_STEP)}), region, cam_from_facet, surface
        )
        by_place = (
            np.stack([moved.slope_x[good] - image.slope_x[good], moved.slope_y[good] - image.slope_y[good]]) / _STEP
        )
        seen = whole[box][good].astype(np.float64)
        for pixels in candidates:
            phase = 2 * np.pi / cell * (np.linalg.solve(pixels @ pixels.T, pixels @ seen) @ pixels)
            for harmonic in range(1, _HARMONICS + 1):
                amplitude = cell / (np.sqrt(2.0 * len(candidates)) * np.pi * harmonic)
                found += [amplitude * wave(harmonic * phase) * by_place @ solver.T for wave in (np.cos, np.sin)]
    # As few modes as have the same covariance.
    _, sizes, directions = np.linalg.svd(np.array(found).reshape(len(found), -1), full_matrices=False)
    modes = (sizes[:, None] * directions).reshape(-1, *common.coefficients.shape[1:])
    return replace(
        common,
        sources=(*common.sources, *(CELLS for _ in modes)),
        coefficients=np.concatenate([common.coefficients, modes]),
    )


def _centred(places: IntArray) -> FloatArray:
    low, high = float(places.min()), float(places.max())
    return np.asarray((places - 0.5 * (low + high)) / max(0.5 * (high - low), 1.0))
