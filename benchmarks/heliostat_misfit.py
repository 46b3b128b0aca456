"""What terms explain of real heliostats that are sound: the numbers of `calibration.heliostat.diagnosis.misfit`.

Run: OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/heliostat_misfit.py
Data: ../shared/data/csp/juelich_calibration and juelich_calibration_short (PAINT database): sound heliostats of more
than 20 rows, whole and in parts of 20 to 80 rows, drawn and in succession. Each heliostat counts once.
Asked: the numbers in use are those of largest likelihood; with those of the other heliostats each one's chances are no
smaller than they say.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.stats import f as f_distribution

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from _heliostat_faults import ESTIMATED, sound, units
from _heliostats import line, title

from calibration.heliostat.diagnosis import GAINS, chance_in_sound, class_of, term_gains
from calibration.heliostat.fitting import fit
from heliogauge.errors import EstimationError

PARTS, FEWEST, MOST = 12, 20, 80
# Parts whose fit ends elsewhere are none [rad of the beam].
FAR_RAD = 0.01


def parts(seen, rng):
    """Yield all rows, and rows drawn and in succession."""
    yield np.ones(len(seen), dtype=bool)
    order = np.argsort(seen.time)
    for _ in range(PARTS):
        few, window = np.zeros((2, len(seen)), dtype=bool)
        few[rng.choice(len(seen), int(rng.integers(FEWEST, MOST + 1)), replace=False)] = True
        size = int(rng.integers(FEWEST, MOST + 1))
        start = int(rng.integers(0, len(seen) - size))
        window[order[start : start + size]] = True
        yield few
        yield window


def gains():
    """Return the gain of each term in each part: heliostat, part, kind, and the numbers of `chance_in_sound`."""
    rng, found = np.random.default_rng(3), []
    for name in [one for one in sound() if len(units()[one][1]) > MOST]:
        design, seen, plant = units()[name]
        for number, part in enumerate(parts(seen, rng)):
            try:
                fitted = fit(design, seen.select(part), ESTIMATED)
            except EstimationError:
                continue
            if np.median(fitted.residuals.beam_angle_rad) > FAR_RAD:
                continue
            for one in term_gains(fitted, plant.targets, plant.site):
                numbers = (max(one.gain, 1e-6), one.freedom, one.spare, one.looks, one.misfit)
                found.append((name, number, one.kind, *numbers))
    return found


def likeliest(table):
    """Return mean and freedom of largest likelihood; each heliostat counts as one."""
    names = np.array([row[0] for row in table])
    gain, q, spare, looks, misfit = np.array([row[3:] for row in table], dtype=float).T
    share = 1 / np.array([(names == name).sum() for name in names])
    white = (1 + 2 * np.log(looks) / q) / spare

    def loss(logs):
        mean, freedom = np.exp(logs)
        expected = white + misfit * mean
        known = np.minimum(1 / (misfit / freedom + (1 - misfit) / spare), spare)
        return -float(share @ (f_distribution.logpdf(gain / q / expected, q, known) - np.log(expected * q)))

    starts = [(np.log(a), np.log(b)) for a in (1e-3, 0.03, 0.1) for b in (5.0, 30.0)]
    best = min((minimize(loss, start, method="Nelder-Mead") for start in starts), key=lambda one: one.fun)
    return np.exp(best.x)


def chances(table):
    return np.array(
        [chance_in_sound(kind, g, int(q), spare=v, looks=int(n), misfit=m) for _, _, kind, g, q, v, n, m in table]
    )


def main():
    title("terms in sound heliostats")
    table = gains()
    for one, used in GAINS.items():
        mine = [row for row in table if class_of(row[2]) == one]
        mean, freedom = likeliest(mine)
        near = abs(mean - used.mean) < 0.1 * used.mean + 0.002
        near = near and (used.mean == 0 or abs(np.log(freedom / used.freedom)) < 0.3)
        line(f"{one}: mean, freedom", f"{used.mean:g}, {used.freedom:g}", f"{mean:.4f}, {freedom:.1f}", near)
        apart = []
        for name in dict.fromkeys(row[0] for row in mine):
            mean, freedom = likeliest([row for row in mine if row[0] != name])
            before = GAINS[one]
            GAINS[one] = type(before)(float(mean), float(freedom))
            apart.append(chances([row for row in mine if row[0] == name]))
            GAINS[one] = before
        apart = np.concatenate(apart)
        for level in (0.1, 0.01, 0.001):
            share = float((apart < level).mean())
            line(f"  by the others, below {level:g}", f"<= {2 * level:g}", f"{share:.4f}", share <= 2 * level)
    whole = {}
    for row, chance in zip(table, chances(table), strict=True):
        whole.setdefault(row[:2], []).append(chance)
    worst = [min(one) * len(one) for one in whole.values()]
    line(
        f"{len(worst)} wholes and parts: the least chance, all terms counted",
        "> 0.005",
        f"{min(worst):.4f}",
        min(worst) > 0.005,
    )


if __name__ == "__main__":
    main()
