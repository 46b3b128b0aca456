"""Poses of a heliostat's mirror, their derivatives, and the way back: time beside each other in one run.

Run with ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/heliostat_kinematics.py``.
"""

import time

import numpy as np
from _measure import row, title

from calibration.heliostat.kinematic_model import ActuatorNumbers, aim, linear_actuators, mirror_poses, pose_derivatives

OBSERVATIONS = 100


def microseconds(function, repeats=100, rounds=20):
    """Fastest of several rounds: other work on the machine only adds time."""
    times = []
    for _ in range(rounds):
        begin = time.process_time()
        for _ in range(repeats):
            function()
        times.append((time.process_time() - begin) / repeats)
    return 1e6 * min(times)


def main():
    actuators = (
        ActuatorNumbers(0.0137, 0.0757, 0.3353, 0.3381, 154166.6667, False, (0.0, 69001.0)),
        ActuatorNumbers(0.9371, 0.0784, 0.3408, 0.3191, 154166.6667, True, (0.0, 75454.0)),
    )
    design = linear_actuators("unit", (0.0, 60.0, 2.0), actuators)
    values = design.parameters.values
    columns = design.parameters.indices(design.free_sets["15"])
    readings = np.random.default_rng(0).uniform(20_000, 50_000, (OBSERVATIONS, 2))

    def differences():
        for column in columns:
            for step in (-1e-6, 1e-6):
                moved = values.copy()
                moved[column] += step
                mirror_poses(design, moved, readings)

    poses = microseconds(lambda: mirror_poses(design, values, readings))
    with_derivatives = microseconds(lambda: pose_derivatives(design, values, readings, columns=columns))
    by_differences = microseconds(differences, repeats=10)
    sun, target = np.array([0.3, -0.8, 0.5]), np.tile([0.0, 0.0, 40.0], (OBSERVATIONS, 1))
    back = microseconds(lambda: aim(design, values, sun, target), repeats=10)

    title(f"{OBSERVATIONS} observations of a heliostat with two linear actuators", ("measured", "asked", "poses alone"))
    row("poses [us]", f"{poses:.0f}", "", "1.0")
    row("poses and 15 derivatives [us]", f"{with_derivatives:.0f}", "< 1000", f"{with_derivatives / poses:.1f}")
    row("15 derivatives by central differences [us]", f"{by_differences:.0f}", "", f"{by_differences / poses:.1f}")
    row("aim: readings from aim points [us]", f"{back:.0f}", "", f"{back / poses:.1f}")


if __name__ == "__main__":
    main()
