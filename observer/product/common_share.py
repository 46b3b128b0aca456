"""What a whole map of a trough has in common: cameras and absorber, as smooth modes and a rest."""

import numpy as np

from heliogauge.slopes.map import CommonModes, monomials, no_common_modes
from heliogauge.validate import FloatArray
from observer.slopes.joint_solution import SlopeErrors

#: Degree of the polynomials across and along: the cameras' errors leave ripples beyond, which count as random.
_DEGREE = 6
#: Columns on which modes are fitted; the modes are smooth.
_FITTED = 64


def common_share(
    errors: SlopeErrors, nodes_m: tuple[FloatArray, FloatArray], *, to_tube: bool = False
) -> tuple[CommonModes, FloatArray]:
    """Split the variance that cameras and absorber bring into smooth modes and a rest that counts as random.

    nodes_m: Columns and rows [m].
    to_tube: Whether the share of the slope against the tube as it is is wanted (`TubeShare`), where the solution
        has it.
    Returns: Modes of slope_x; slope_y has none.
    Returns (r, nx): Variance of slope_x that the modes leave [rad^2].
    """
    x, y = nodes_m
    center = np.array([0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1])])
    scale = 0.5 * max(float(np.ptp(x)), float(np.ptp(y)), 1e-3)
    columns = np.unique(np.linspace(0, x.size - 1, min(_FITTED, x.size)).round().astype(np.intp))
    at_y, whole = y[errors.mode_rows], errors.shared[..., 0]
    parts = [("camera poses", errors.modes[:, :, columns]), ("absorber", errors.modes_apart[:, :, columns])]
    if to_tube and errors.to_tube is not None:
        whole = errors.to_tube.variance
        parts = [("camera poses and absorber", errors.to_tube.modes[:, :, columns])]
    sources: list[str] = []
    coefficients = []
    # Where no edge is near, as behind supports, nothing hangs on cameras and absorber: the modes do not go on there.
    noise = errors.random[errors.mode_rows][:, columns, 0, 0]
    weight = 1 / np.sqrt(noise + np.median(noise))
    for source, modes in parts:
        if modes.shape[0] == 0:
            continue
        # Few rows determine few powers of y.
        degree = min(_DEGREE, at_y.size - 1)
        u, v = np.meshgrid((x[columns] - center[0]) / scale, (at_y - center[1]) / scale)
        terms = monomials(u, v, _DEGREE).reshape(-1, u.size)
        allowed = np.array([j <= degree for n in range(_DEGREE + 1) for j in range(n + 1)])
        weighted = (terms[allowed] * weight.ravel()).T, (modes * weight).reshape(len(modes), -1).T
        of_terms = np.linalg.lstsq(*weighted, rcond=None)[0].T
        if len(of_terms) > len(of_terms.T):
            # There are no more independent polynomials than terms.
            _, size, independent = np.linalg.svd(of_terms, full_matrices=False)
            of_terms = size[:, None] * independent
        fitted = np.zeros((len(of_terms), 2, terms.shape[0]))
        fitted[:, 0, allowed] = of_terms
        coefficients.append(fitted)
        sources += [source] * len(fitted)
    if not sources:
        return no_common_modes(), whole
    common = CommonModes(tuple(sources), np.concatenate(coefficients), center, scale)
    smooth = common.variance_on_grid(x, y)[0]
    return common, np.asarray(np.maximum(whole - smooth, 0.0))
