"""One robust fit of a heliostat with covariance, beside scipy in the same run; real heliostats by split.

Run with one thread: ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/heliostat_fit.py``. The first table
fits 150 synthetic beams of a heliostat with linear actuators, 15 parameters within priors, 3 % gross errors. scipy gets
the same residuals with derivatives, the same Huber loss and the same start, and no covariance. The second table needs
the real heliostats beside the project: median over the six sound ones of the beam's RMS where it was not fitted.
"""

import sys
import time

import numpy as np
from _measure import ROOT, row, title
from scipy.optimize import least_squares

sys.path.insert(0, str(ROOT))

from calibration.heliostat.fitting import PRIORS, fit, make_split, with_priors
from calibration.heliostat.kinematic_model import ActuatorNumbers, linear_actuators
from calibration.heliostat.observations import BeamSpots, ObservationModel, Observations, Pointings, evaluate

COUNT, SIGMA_M = 150, 0.05
FREE = (
    "tilt_1_n",
    "tilt_1_u",
    "tilt_2_e",
    "tilt_2_n",
    "initial_angle_2",
    "initial_stroke_1",
    "initial_stroke_2",
    "offset_1",
    "offset_2",
    "pivot_radius_1",
    "pivot_radius_2",
    "position_e",
    "position_n",
    "position_u",
)


def synthetic(rng):
    """Return a heliostat with priors and beams of one whose numbers are drawn from them."""
    from calibration.heliostat.kinematic_model import aim, mirror_poses
    from heliogauge.geometry.rays import reflect

    first = ActuatorNumbers(0.0137, 0.0757, 0.3353, 0.3381, 154166.7, False, (0.0, 69001.0))
    second = ActuatorNumbers(0.9371, 0.0784, 0.3408, 0.3191, 154166.7, True, (0.0, 75454.0))
    design = with_priors(linear_actuators("synthetic", [20.0, 180.0, 1.7], (first, second)), (*FREE, "sag_1"))
    truth = design.parameters.values + rng.normal(0, 1, len(design.parameters)) * design.parameters.sigmas
    azimuth, elevation = rng.uniform(1.9, 4.4, COUNT), rng.uniform(0.2, 1.0, COUNT)
    level = np.cos(elevation)
    sun = np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=1)
    target = np.array([0.0, 0.0, 36.0])
    readings = aim(design, design.parameters.values, sun, target).readings
    poses = mirror_poses(design, truth, readings)
    beams = reflect(-sun, poses.normals(design))
    spots = poses.centre_m + beams * np.linalg.norm(target - poses.centre_m, axis=1)[:, None]
    spots = spots + rng.normal(0, SIGMA_M, spots.shape)
    spots[rng.permutation(COUNT)[: COUNT * 3 // 100]] += [0.0, 0.0, 4.0]
    return design, Observations((BeamSpots.at_points(Pointings(readings), sun, spots, SIGMA_M, ("t",) * COUNT),))


def cpu_s(function, repeats=7):
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        function()
        times.append(time.process_time() - begin)
    return min(times)


def scipy_fit(design, seen):
    """Minimise the same robust cost with the same derivatives, without covariance, rejection or scale."""
    columns = np.flatnonzero(design.parameters.free)
    model = ObservationModel(design, seen, columns)
    start, sigmas = design.parameters.values[columns], design.parameters.sigmas[columns]

    def full(free):
        values = design.parameters.values.copy()
        values[columns] = free
        return values

    def residuals(free):
        return np.concatenate([model.whitened(full(free))[0], (free - start) / sigmas])

    def jacobian(free):
        return np.concatenate([model.whitened(full(free))[1], np.diag(1 / sigmas)])

    return least_squares(residuals, start, jacobian, method="trf", loss="huber", f_scale=1.5, x_scale=sigmas)


def speed():
    design, seen = synthetic(np.random.default_rng(0))
    own, other = cpu_s(lambda: fit(design, seen)), cpu_s(lambda: scipy_fit(design, seen))
    found = fit(design, seen)
    title("150 observations, 15 parameters, CPU time of one core")
    row("robust fit, covariance, rejection, observability", f"{1e3 * own:.1f} ms", "50 ms", "11-26 s (ARTIST)")
    row("scipy least_squares, Huber, same derivatives, no covariance", f"{1e3 * other:.1f} ms", "", "")
    row("ratio", f"{own / other:.2f}", "", "")
    row("free parameters; rejected of 4 gross errors", f"{found.n_free}; {int(found.rejected.sum())}", "15; 4", "")


def rms_mrad(found, seen):
    return 1e3 * np.sqrt(np.mean(evaluate(found.design, found.values, seen).beam_angle_rad ** 2))


def real():
    from tests.calibration.juelich import FOLDER, SOUND, heliostat

    if not FOLDER.is_dir():
        print(f"\nno real heliostats at {FOLDER}")
        return
    units = [heliostat(name) for name in SOUND]
    ways = {
        "4 tilts": lambda design, seen: fit(design.with_free("4"), seen),
        "15 parameters": lambda design, seen: fit(design.with_free("15"), seen),
        "priors": lambda design, seen: fit(with_priors(design), seen),
    }
    title("Beam RMS of rows left aside, mrad, median of six heliostats, each for itself", tuple(ways))
    for name in ("chronological", "random", "azimuth", "azimuth-reversed", "high-variance"):
        cells = []
        for way in ways.values():
            errors = []
            for design, seen in units:
                split = make_split(seen, name)
                errors.append(rms_mrad(way(design, seen.select(split.train)), seen.select(split.test)))
            cells.append(f"{np.median(errors):.2f}")
        row(name, *cells)
    print(f"  (sigma of the height before anything is measured: {PRIORS['position_u'].sigma:g} m)")


if __name__ == "__main__":
    speed()
    real()
