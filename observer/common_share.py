"""What a whole map of a trough has in common: cameras and absorber, as smooth modes and a rest."""

import numpy as np

from heliogauge.slope_map import CommonModes, monomials, no_common_modes
from heliogauge.validate import FloatArray
from observer.absorber_path import AbsorberPath
from observer.design import Collector
from observer.joint_solution import SlopeErrors

#: Degree of the polynomials across and along: the cameras' errors leave ripples beyond, which count as random.
_DEGREE = 6
#: Combinations of the absorber's coordinates that are kept.
_ABSORBER_MODES = 8
#: Columns and rows on which modes are fitted and compared; the modes are smooth.
_FITTED = (64, 64)


def absorber_modes(absorber: AbsorberPath, collector: Collector, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Return how the separated slope changes with the absorber's strongest uncertain movements.

    Parameters
    ----------
    absorber : AbsorberPath
        Its axis with covariance.
    collector : Collector
        The design.
    x_m, y_m : ndarray, shapes (nx,) and (r,)
        Nodes [m].

    Returns
    -------
    ndarray, shape (k, r, nx)
        Change of dz/dx for one standard deviation of each independent movement [rad].

    Notes
    -----
    theta_r = theta_ra - theta_a with theta_a = (beta_0 - beta) / 2 and dz/dx = -tan(angle): what the absorber is placed
    too far to +x turns up as half the angle that it subtends.
    """
    values, vectors = np.linalg.eigh(absorber.covariance_m2)
    strongest = np.argsort(values)[::-1][:_ABSORBER_MODES]
    strongest = strongest[values[strongest] > 1e-14]
    movement = vectors[:, strongest] * np.sqrt(values[strongest])
    x = x_m[None, None, :]
    z = x**2 / (4 * collector.focal_length_m)
    axis_x, axis_z = (part[None, :, None] for part in absorber.at(y_m))
    square = (axis_x - x) ** 2 + (axis_z - z) ** 2
    by_x, by_z = (
        np.array([np.interp(y_m, absorber.y_m, column) for column in part.T]).reshape(-1, y_m.size, 1)
        for part in (movement[: absorber.n], movement[absorber.n :])
    )
    turned = 0.5 * ((axis_z - z) * by_x - (axis_x - x) * by_z) / square
    return np.asarray(turned * (1 + (x / (2 * collector.focal_length_m)) ** 2))


def common_share(
    errors: SlopeErrors, nodes_m: tuple[FloatArray, FloatArray], absorber: AbsorberPath, collector: Collector
) -> tuple[CommonModes, FloatArray]:
    """Split the variance that cameras and absorber bring into smooth modes and a rest that counts as random.

    Parameters
    ----------
    errors : SlopeErrors
        The solution.
    nodes_m : (ndarray, ndarray), shapes (nx,) and (r,)
        Columns and rows [m].
    absorber : AbsorberPath
        The tube's axis with covariance.
    collector : Collector
        The design.

    Returns
    -------
    CommonModes
        Modes of slope_x; slope_y has none.
    ndarray, shape (r, nx)
        Variance of slope_x that the modes leave [rad^2].
    """
    x, y = nodes_m
    center = np.array([0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1])])
    scale = 0.5 * max(float(np.ptp(x)), float(np.ptp(y)), 1e-3)
    columns = np.unique(np.linspace(0, x.size - 1, min(_FITTED[0], x.size)).round().astype(np.intp))
    rows = np.unique(np.linspace(0, y.size - 1, min(_FITTED[1], y.size)).round().astype(np.intp))
    parts = [
        ("camera poses", errors.modes[:, :, columns], y[errors.mode_rows]),
        ("absorber", absorber_modes(absorber, collector, x[columns], y[rows]), y[rows]),
    ]
    sources: list[str] = []
    coefficients = []
    for source, modes, at_y in parts:
        if modes.shape[0] == 0:
            continue
        # Few rows determine few powers of y.
        degree = min(_DEGREE, at_y.size - 1)
        u, v = np.meshgrid((x[columns] - center[0]) / scale, (at_y - center[1]) / scale)
        terms = monomials(u, v, _DEGREE).reshape(-1, u.size)
        allowed = np.array([j <= degree for n in range(_DEGREE + 1) for j in range(n + 1)])
        fitted = np.zeros((modes.shape[0], 2, terms.shape[0]))
        fitted[:, 0, allowed] = np.linalg.lstsq(terms[allowed].T, modes.reshape(len(modes), -1).T, rcond=None)[0].T
        coefficients.append(fitted)
        sources += [source] * len(modes)
    whole = errors.shared[..., 0] + np.square(absorber_modes(absorber, collector, x, y)).sum(axis=0)
    if not sources:
        return no_common_modes(), whole
    common = CommonModes(tuple(sources), np.concatenate(coefficients), center, scale)
    smooth = np.square(common.evaluate(*np.meshgrid(x, y))[:, 0]).sum(axis=0)
    return common, np.asarray(np.maximum(whole - smooth, 0.0))
