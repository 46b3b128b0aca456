"""What the size of a dot does to its centre: waviness of the mirror bends the disc, and its middle moves."""

import numpy as np

from heliogauge.validate import BoolArray, FloatArray

#: Neighbours of a dot and the dot itself, in columns and rows.
_AROUND = tuple((column, row) for row in (-1, 0, 1) for column in (-1, 0, 1))
#: So many of these nine determine the six coefficients of a quadratic and leave two over.
_FEWEST = 8


def shift_of_size(places_px: FloatArray, places_m: FloatArray, shapes_px2: FloatArray) -> FloatArray:
    """Return how far the middle of each dot's image is from the image of its middle, shape (rows, columns, 2) [px].

    places_px (rows, columns, 2): Middles of the images, NaN where there is none [px].
    places_m (rows, columns, 3): Places of the dots on the screen [m].
    shapes_px2 (rows, columns, 2, 2): Ellipses of the images [px^2].
    Returns: NaN where a dot has not enough neighbours.

    With the image ``p(s) = p0 + A s + s B s / 2`` of places s about the dot, from its neighbours, the area of a disc
    with second moments C about its middle has its own middle at ``p0 + B:C / 2 + A C t``, ``t`` the gradient of the
    logarithm of the determinant of the derivative of p. For waviness of wave number k this lowers slopes by the share
    3/8 k^2 R^2, R the radius of the dot on the mirror: for dots of 11 mm by 5 % of waves of 100 mm.
    """
    rows, columns = places_px.shape[:2]
    shift = np.full((rows, columns, 2), np.nan)
    curved = np.full((rows, columns, 2, 2, 2), np.nan)
    image, places = (np.full((9, rows, columns, k), np.nan) for k in (2, 3))
    for number, (column, row) in enumerate(_AROUND):
        to = slice(max(-row, 0), rows - max(row, 0)), slice(max(-column, 0), columns - max(column, 0))
        start = slice(max(row, 0), rows - max(-row, 0)), slice(max(column, 0), columns - max(-column, 0))
        image[number][to], places[number][to] = places_px[start], places_m[start]
    there = np.isfinite(image[..., 0]) & np.isfinite(places[..., 0])
    usable = there[4] & (there.sum(axis=0) >= _FEWEST)
    if not usable.any():
        return shift
    known = there[:, usable].T
    image = np.moveaxis(image[:, usable], 0, 1)
    image = np.where(known[..., None], image - image[:, 4:5], 0.0)
    on_screen = _in_tangents(np.moveaxis(places[:, usable], 0, 1), known)
    derivative, second = _quadratic(on_screen, image, known)
    curved[usable] = second
    second = _sharpened(curved)[usable]
    inverse = np.linalg.inv(derivative)
    # A uniform ellipse with semi-axes a has second moments a^2 / 4.
    moments = 0.25 * inverse @ shapes_px2[usable] @ np.swapaxes(inverse, 1, 2)
    density = np.einsum("nli,nilk->nk", inverse, second)
    own = 0.5 * np.einsum("nijk,njk->ni", second, moments)
    shift[usable] = own + np.einsum("nij,njk,nk->ni", derivative, moments, density)
    return shift


def _in_tangents(places_m: FloatArray, known: BoolArray) -> FloatArray:
    """Return places (n, 9, 3) about the middle one in two directions along the screen, shape (n, 9, 2) [m]."""
    off = np.where(known[..., None], places_m - places_m[:, 4:5], 0.0)
    steps = np.array(_AROUND, dtype=np.float64)
    across = np.einsum("k,nki->ni", steps[:, 0], off)
    down = np.einsum("k,nki->ni", steps[:, 1], off)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    down -= np.einsum("ni,ni->n", down, across)[:, None] * across
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    return np.asarray(np.einsum("nki,nji->nkj", off, np.stack([across, down], axis=1)))


def _quadratic(places_m: FloatArray, image_px: FloatArray, known: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Fit quadratics; return derivatives (n, 2, 2): of image by place, and second derivatives (n, 2, 2, 2)."""
    scale = np.sqrt(np.mean(places_m**2))
    x, y = np.moveaxis(places_m / scale, -1, 0)
    terms = np.stack([np.ones_like(x), x, y, 0.5 * x * x, x * y, 0.5 * y * y], axis=-1) * known[..., None]
    products = np.swapaxes(terms, 1, 2) @ terms
    found = np.linalg.solve(products, np.swapaxes(terms, 1, 2) @ image_px)
    derivative = np.swapaxes(found[:, 1:3], 1, 2) / scale
    (xx, xy, yy) = np.moveaxis(found[:, 3:], 1, 0) / scale**2
    second = np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-1)
    return derivative, second


def _sharpened(second: FloatArray) -> FloatArray:
    """Return second derivatives (rows, columns, 2, 2, 2) without what their neighbourhood of three dots takes away.

    Of waves with a and b radians from dot to dot along columns and rows the fit keeps the share 1 - a^2/12 - b^2/3 of
    the second derivative along columns, 1 - a^2/3 - b^2/12 along rows, and 1 - (a^2 + b^2)/6 of the mixed one.
    """
    sharp = second.copy()
    by_column, by_row = (_bend(second, axis) for axis in (1, 0))
    for first, other, of_columns, of_rows in ((0, 0, 12, 3), (1, 1, 3, 12), (0, 1, 6, 6), (1, 0, 6, 6)):
        part = np.s_[..., first, other]
        sharp[part] -= by_column[part] / of_columns + by_row[part] / of_rows
    return sharp


def _bend(values: FloatArray, axis: int) -> FloatArray:
    """Return second differences along an axis; 0 where a neighbour is missing."""
    along = np.moveaxis(values, axis, 0)
    bend = np.zeros_like(along)
    bend[1:-1] = np.nan_to_num(along[2:] - 2 * along[1:-1] + along[:-2])
    return np.moveaxis(bend, 0, axis)
