"""Intercept factors of simulated measurements, evaluated from edges on, against those of the true mirrors and tubes."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.sunlight.sun_shapes import GaussianSun
from observer.light.beam import beam_profile, sun_profile
from observer.light.best import best_offset
from observer.light.cases import Case, intercept_at_offsets, intercept_gain, measured_trough, optics_of
from observer.planning.simulated_edges import EdgeNoise
from observer.planning.simulated_flight import Evaluation, simulate
from observer.trough.typical_mirror import TypicalMirror
from tests.observer.simulated_trough import believed_with_errors, short_scene, short_trough

NOISE = EdgeNoise(reflection_px=1.0, absorber_px=0.1)
EVALUATION = Evaluation(column_step_m=0.08, station_step_m=0.5, along_rad=1e-3)
OFFSETS = (-5e-3, 0.0, 5e-3)


def normalised_errors(seed: int) -> list[float]:
    """Return errors over sigmas of one measurement: intercept factors of all cases, gain, best offset."""
    rng = np.random.default_rng(seed)
    scene = short_scene(TypicalMirror.drawn(short_trough(), rng, 3e-3, 1e-4), photos=32)
    one = simulate(scene, believed_with_errors(scene, rng, position_m=1e-3), NOISE, EVALUATION, rng)
    measured = measured_trough(one.slope_map, one.absorber, short_trough(), slope_covariance=one.reflector.sums)
    # Truth at the measured nodes: what the rest of the mirror may do has its own test.
    measured = replace(measured, missing=replace(measured.missing, weight=np.zeros_like(measured.missing.weight)))
    slopes = np.where(one.slope_map.valid, one.slope_map.design_slope_x + one.true_error_x, np.nan)
    true = measured_trough(replace(one.slope_map, slope_x=slopes), scene.truth.absorber, short_trough())
    light = beam_profile(sun_profile(GaussianSun(2.73e-3)), tracking_error_rad=3e-3)
    found = {case: optics_of(measured, case, light) for case in Case}
    right = {case: optics_of(true, case, light) for case in Case}
    errors: list[float] = []
    for case in Case:
        stated = intercept_at_offsets(measured, case, found[case], OFFSETS)
        errors += list((stated.ratio - [right[case].ratio(offset) for offset in OFFSETS]) / stated.sigma_ratio)
    gain, sigma = intercept_gain(measured, found, Case.ABSORBER_ALIGNED)
    true_gain = right[Case.ABSORBER_ALIGNED].ratio() - right[Case.AS_MEASURED].ratio()
    best = best_offset(measured, Case.AS_MEASURED, found[Case.AS_MEASURED])
    true_best = best_offset(true, Case.AS_MEASURED, right[Case.AS_MEASURED])
    away = (best.place - true_best.place)[0] / np.sqrt(best.covariance[0, 0])
    return [*errors, (gain - true_gain) / sigma, float(away)]


@pytest.mark.slow
def test_measurements_err_by_their_sigma() -> None:
    found = np.array([normalised_errors(seed) for seed in range(16)])
    scatter = np.sqrt(np.mean(found**2, axis=0))
    # 16 runs know a scatter to 18 %; slopes between photos are overrated by some 15 %, see test_monte_carlo.
    assert (scatter > 0.45).all()
    assert (scatter < 1.6).all()
