"""Largest values of smooth functions of one or two numbers: importing an optimiser takes longer than the search."""

from collections.abc import Callable

import numpy as np

from heliogauge.validate import FloatArray

_GOLDEN = 0.5 * (3.0 - np.sqrt(5.0))
#: A climb ends where a step gains less than this share of the value, or after so many steps.
_LEAST_GAIN, _MOST_STEPS = 1e-13, 60
#: A step that gains less than this part of what the slope promises is halved.
_ARMIJO, _SHORTEST = 1e-4, 1e-6


def largest_between(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Return where a function with one maximum between two places is largest.

    tolerance: How near the result is wanted.

    Parabolas through the three best places, golden sections where these do not converge (Brent 1973, chapter 5).
    """
    best = second = third = low + _GOLDEN * (high - low)
    at_best = at_second = at_third = function(best)
    step = before = 0.0
    while abs(best - 0.5 * (low + high)) > 2 * tolerance - 0.5 * (high - low):
        first, other = (best - second) * (at_best - at_third), (best - third) * (at_best - at_second)
        down = 2 * (other - first)
        up = (best - third) * other - (best - second) * first
        up, down = (-up, down) if down > 0 else (up, -down)
        is_near = abs(up) < abs(0.5 * down * before)
        if abs(before) > tolerance and is_near and down * (low - best) < up < down * (high - best):
            before, step = step, up / down
            if min(best + step - low, high - best - step) < 2 * tolerance:
                step = tolerance if best < 0.5 * (low + high) else -tolerance
        else:
            before = (high if best < 0.5 * (low + high) else low) - best
            step = _GOLDEN * before
        trial = best + (step if abs(step) >= tolerance else np.copysign(tolerance, step))
        value = function(trial)
        if value >= at_best:
            low, high = (best, high) if trial >= best else (low, best)
            third, at_third, second, at_second = second, at_second, best, at_best
            best, at_best = trial, value
        else:
            low, high = (trial, high) if trial < best else (low, trial)
            if value >= at_second or second == best:
                third, at_third, second, at_second = second, at_second, trial, value
            elif value >= at_third or third in (best, second):
                third, at_third = trial, value
    return float(best)


def climb(function: Callable[[FloatArray], tuple[float, FloatArray]], start: FloatArray, longest: float) -> FloatArray:
    """Return the maximum that lies uphill of a place.

    Shapes: start (p,).
    function: From a place, shape (p,), to value and derivatives there.
    Returns (p,): Where the function does not grow any more.

    Quasi-Newton steps with the update of Broyden, Fletcher, Goldfarb and Shanno, halved until they gain.
    """
    place, unit = np.array(start), np.eye(len(start))
    value, slope = function(place)
    inverse = unit * longest / max(float(np.linalg.norm(slope)), 1e-300)
    for _ in range(_MOST_STEPS):
        step = inverse @ slope
        step *= min(1.0, longest / max(float(np.linalg.norm(step)), 1e-300))
        part, (found, turned) = 1.0, function(place + step)
        while found < value + _ARMIJO * part * float(slope @ step) and part > _SHORTEST:
            part *= 0.5
            found, turned = function(place + part * step)
        if found - value <= _LEAST_GAIN * abs(value):
            break
        way, bend = part * step, slope - turned
        if float(way @ bend) > 0:
            share = 1 / float(way @ bend)
            left = unit - share * np.outer(way, bend)
            inverse = left @ inverse @ left.T + share * np.outer(way, way)
        place, value, slope = place + way, found, turned
    return place
