"""Centres of rendered targets at SNR 200: rms error, chi-square, bias under a sloping ground, time."""

import time

import numpy as np
from _measure import row, title

from data_synth.targets import IsolatedTarget, draw_isolated
from heliogauge.errors import EstimationError
from photogrammetry.centers import Ellipse, measure_center

ASKED_PX = {6: 0.0047, 12: 0.0034, 30: 0.0022}
TRIALS = 100


def run(target: IsolatedTarget):
    """Errors (n, 2), chi-squares (n,), time for one [s]; the eccentricity of a target seen square on is 0."""
    rng = np.random.default_rng(11)
    errors, squares, seconds = [], [], 0.0
    for _ in range(TRIALS):
        drawn = draw_isolated(target, rng)
        image = np.asarray(drawn.image_dn, dtype=np.float64)
        start = Ellipse(drawn.center_px + rng.normal(0, 0.2, 2), np.eye(2) * (0.5 * target.diameter_px) ** 2)
        begin = time.process_time()
        try:
            found = measure_center(image, start)
        except EstimationError:
            continue
        finally:
            seconds += time.process_time() - begin
        error = found.center_px - drawn.center_px
        errors.append(error)
        squares.append(error @ np.linalg.solve(found.covariance_px2, error))
    return np.array(errors), np.array(squares), seconds / TRIALS


if __name__ == "__main__":
    title("blurred disc", ("measured", "asked", ""))
    for diameter, asked in ASKED_PX.items():
        errors, squares, seconds = run(IsolatedTarget(float(diameter)))
        row(f"{diameter} px: rms of x and y [px]", f"{np.sqrt(np.mean(errors**2)):.4f}", f"{asked}", "")
        row(f"{diameter} px: chi-square / 2", f"{squares.mean() / 2:.2f}", "1", "")
        row(f"{diameter} px: not measured; time [ms]", f"{TRIALS - len(errors)}; {1e3 * seconds:.2f}", "", "")
        sloping, _, _ = run(IsolatedTarget(float(diameter), slope_dn_per_px=(1.0, 0.0)))
        row(f"{diameter} px: bias, ground 1 DN/px [px]", f"{sloping.mean(axis=0)[0]:+.4f}", "0.02", "")
