"""A field of heliostats through the whole command: what it predicts of each from the others; time and memory.

Run: python benchmarks/heliostat_field.py [HELIOSTATS OBSERVATIONS], or heliostat_field.py real [FOLDER].
With "real", every heliostat of the real folders beside the project is predicted, split by split, with what the others
of the field know (as many folds as heliostats): beam RMS of rows left aside, over the error that was expected; then by
models that a user states, whose errors are judged by the same. Rows that one fit predicts miss together and are worth
two to twenty independent components: where what is expected is true, the median ratio of six heliostats still lies
anywhere from 0.5 to 1.3, and one of 85 is above 2 more often than not.
Asked: 10,000 heliostats x 100 observations within 10 minutes on 2 cores, memory flat. A smaller field is calibrated
(300 by default, as many as are looked at twice) and the time of each heliostat of the field of twice the size is taken
10,000 times. Each process has one thread. The plain fit is made every few seconds beside the command: a busy machine
slows both.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from calibration.heliostat import Options, run
from calibration.heliostat.kinematic_model import PlaneTarget, aim, azimuth_elevation
from heliogauge import load
from heliogauge.geometry.sun import Site, sun_directions
from heliogauge.measurement.writer import dump_toml
from heliogauge.results.tables import write_table_csv

SITE = Site(37.0, -2.0, 500.0)
TARGET = PlaneTarget.facing("tower", np.array([0.0, 0.0, 80.0]), 0.0, 12.0, 10.0)
ASKED, MINUTES = 10_000, 10.0
SIGMA_M = 0.03
_PLAIN_EVERY_S = 3.0


def write_field(folder: Path, heliostats: int, observations: int) -> None:
    """Write tables of heliostats with tilts and offsets of some milliradians."""
    rng = np.random.default_rng(0)
    positions = np.column_stack(
        [rng.uniform(-300, 300, heliostats), rng.uniform(80, 600, heliostats), np.full(heliostats, 3.0)]
    )
    days = np.datetime64("2026-01-03", "ms") + np.arange(observations) * 37 % 365 * np.timedelta64(1, "D")
    times = np.sort(days + (np.arange(observations) * 53 % 300 + 570) * np.timedelta64(1, "m"))
    suns = sun_directions(times, SITE)
    rows: dict[str, list] = {
        name: []
        for name in (
            "heliostat",
            "time_utc",
            "axis_1_rad",
            "axis_2_rad",
            "target",
            "x_m",
            "y_m",
            "sigma_mm",
        )
    }
    for number, position in enumerate(positions):
        errors = rng.normal(0, 3e-3, 5)
        names = ("tilt_north", "tilt_east", "azimuth_offset", "elevation_offset", "non_orthogonality")
        truth = azimuth_elevation("h", position).with_value(dict(zip(names, errors, strict=True)))
        xy = rng.uniform(-2, 2, (observations, 2))
        found = aim(truth, truth.parameters.values, suns, TARGET.points(xy))
        seen = xy + rng.normal(0, SIGMA_M, xy.shape)
        rows["heliostat"] += [f"H{number:05d}"] * observations
        rows["time_utc"] += [f"{time}Z" for time in times]
        rows["axis_1_rad"] += found.readings[:, 0].tolist()
        rows["axis_2_rad"] += found.readings[:, 1].tolist()
        rows["target"] += [TARGET.name] * observations
        rows["x_m"] += seen[:, 0].tolist()
        rows["y_m"] += seen[:, 1].tolist()
        rows["sigma_mm"] += [1e3 * SIGMA_M] * observations
    folder.mkdir(parents=True)
    (folder / "measurement.toml").write_text(
        dump_toml(
            {
                "kind": "heliostat",
                "name": "field",
                "site": {
                    "latitude_deg": SITE.latitude_deg,
                    "longitude_deg": SITE.longitude_deg,
                    "altitude_m": SITE.altitude_m,
                },
                "target": [
                    {
                        "name": TARGET.name,
                        "center_m": [0.0, 0.0, 80.0],
                        "width_m": 12.0,
                        "height_m": 10.0,
                        "facing_azimuth_deg": 0.0,
                    }
                ],
            }
        ),
        encoding="utf-8",
    )
    write_table_csv(
        folder / "heliostats.csv",
        {
            "heliostat": [f"H{number:05d}" for number in range(heliostats)],
            "e_m": positions[:, 0],
            "n_m": positions[:, 1],
            "u_m": positions[:, 2],
        },
    )
    write_table_csv(folder / "observations.csv", rows)


def plain_fit_s() -> float:
    """Return the processor time of one plain fit by scipy with our derivatives, without covariance [s]."""
    from heliostat_fit import cpu_s, scipy_fit, synthetic

    design, seen = synthetic(np.random.default_rng(0))
    return float(cpu_s(lambda: scipy_fit(design, seen), repeats=1))


def resident_mib(group: int) -> float:
    """Memory of all processes of a group [MiB]; pages that they share count in each."""
    total = 0.0
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text(encoding="utf-8").rpartition(")")[2].split()
            if int(fields[2]) == group:
                total += int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 2**20
        except (OSError, IndexError, ValueError):
            continue
    return total


def calibrate(folder: Path, out: Path, jobs: int) -> tuple[float, float, float, float]:
    """Run the command; return wall time [s], processor time [s], largest memory [MiB] and a plain fit meanwhile [s]."""
    environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    before = os.times()
    begin = time.perf_counter()
    running = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "heliogauge",
            "heliostat",
            "measure",
            str(folder),
            "-o",
            str(out),
            "--quick",
            "--jobs",
            str(jobs),
            "--no-report",
            "-q",
        ],
        env=environment,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
    )
    most, plain = 0.0, [plain_fit_s()]
    while running.poll() is None:
        if time.perf_counter() - begin > len(plain) * _PLAIN_EVERY_S:
            plain.append(plain_fit_s())
        most = max(most, resident_mib(running.pid))
        time.sleep(0.1)
    wall = time.perf_counter() - begin
    if running.returncode:
        raise SystemExit(f"the command ended with {running.returncode}")
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return wall, cpu, most, float(np.median(plain))


ROOT = Path(__file__).resolve().parents[1]
REAL = ("juelich_calibration", "juelich_calibration_short")
SPLITS = ("azimuth", "azimuth-reversed", "chronological", "random", "high-variance")
#: Asked: median beam RMS of sound heliostats [mrad].
ASKED_MRAD = {"azimuth": "1.8", "azimuth-reversed": "2.8", "chronological": "1.50", "random": "1.32"}
#: Models that a user may state.
STATED = ("8", "15")
#: Both halves of an azimuth split have 30 rows.
WHOLE_SPLIT = 60
_INSIDE_95 = 5.99
_WIDTHS = (7, 8, 8, 8, 12, 8, 8, 9)


def joined(place: Path, folders: list[Path]) -> Path:
    """Return a folder with the heliostats of several, by links."""
    times: dict[str, str] = {}
    for folder in folders:
        for entry in folder.iterdir():
            if entry.is_dir() and not (place / entry.name).exists():
                (place / entry.name).symlink_to(entry)
        times |= json.loads((folder / "timestamps.json").read_text(encoding="utf-8"))
    (place / "timestamps.json").write_text(json.dumps(times), encoding="utf-8")
    return place


def real(folder: Path) -> None:
    """Predict every heliostat of a folder with what the others know, and by models that are stated."""
    result = run(load(folder), Options(thorough=True))
    sound = [one for one in result.heliostats if "actuator_numbers" not in one.diagnosis.kinds]
    whole = [one for one in sound if len(one.seen.observations) >= WHOLE_SPLIT]
    by_field = sum(one.free == "priors of the field" for one in sound)
    print(f"{len(result.heliostats)} heliostats; of {len(sound)} sound ones {by_field} by what the others know")
    told(whole, sound)
    print("\n" + " ".join(f"{name:>10}" for name in ("", *SPLITS)))
    for one in sound:
        cells = [f"{figures(one.held[split])[0]:10.2f}" if split in one.held else f"{'-':>10}" for split in SPLITS]
        print(f"{one.name:>10} " + " ".join(cells))
    for one in result.heliostats:
        if one not in sound:
            print(f"\n{one.name}, {one.free}: RMS of rows left aside [mrad], all and those that the fit to all uses")
            for split in SPLITS:
                print(f"  {split:18}" + "".join(f"{value:>8.2f}" for value in with_and_without(one, split)))
    for model in STATED:
        stated = {one.name: one for one in run(load(folder), Options(thorough=True, model=model)).heliostats}
        print(f"\nmodel {model}, stated")
        told(*([stated[one.name] for one in some if one.name in stated] for some in (whole, sound)))


def told(whole: list[Any], sound: list[Any]) -> None:
    """Print what came of each split, for the heliostats with enough rows and for all."""
    for title, some in ((f"with at least {WHOLE_SPLIT} rows", whole), ("all sound ones", sound)):
        print(f"\n{len(some)} {title}: beam RMS of rows left aside [mrad]; found over expected; rows inside their 95 %")
        print("(where what is expected is true: 95 % of medians, and the chance of so large a worst one)")
        head = ("asked", "median", "worst", "ratio", "if true", "worst", "chance", "inside")
        print(f"  {'split':18}" + "".join(f"{name:>{width}}" for name, width in zip(head, _WIDTHS, strict=True)))
        for split in SPLITS:
            tried = [one for one in some if split in one.held]
            rows = [figures(one.held[split]) for one in tried]
            rms, inside, count = (np.array(column) for column in zip(*rows, strict=True))
            found = [misses for one in tried if (misses := one.misses(split))]
            ratio, freedom = np.array([one.ratio for one in found]), np.array([one.freedom for one in found])
            true = np.sqrt(np.random.default_rng(0).chisquare(freedom, (20_000, freedom.size)) / freedom)
            low, high = np.quantile(np.median(true, axis=1), (0.025, 0.975))
            chance = float(np.mean(true.max(axis=1) >= ratio.max()))
            cells = (
                ASKED_MRAD.get(split, ""),
                f"{np.median(rms):.2f}",
                f"{rms.max():.2f}",
                f"{np.median(ratio):.2f}",
                f"{low:.2f}-{high:.2f}",
                f"{ratio.max():.2f}",
                f"{chance:.3f}",
                f"{100 * np.sum(inside) / np.sum(count):.0f}%",
            )
            print(f"  {split:18}" + "".join(f"{cell:>{width}}" for cell, width in zip(cells, _WIDTHS, strict=True)))


def with_and_without(one: Any, split: str) -> tuple[float, float]:
    """Return the RMS of a heliostat's test rows, and without those that the fit to all rows refuses [mrad]."""
    held = one.held[split]
    both = held.split.train | held.split.test
    angles = np.full(both.size, np.nan)
    angles[both] = 1e3 * held.residuals.beam_angle_rad
    chosen = (held.split.test, held.split.test & one.fit.used)
    with_all, without = (float(np.sqrt(np.nanmean(angles[rows] ** 2))) for rows in chosen)
    return with_all, without


def figures(held: Any) -> tuple[float, float, int]:
    """Return RMS of the test rows [mrad], rows inside their 95 %, and rows."""
    prediction = held.prediction
    tested = held.split.test[held.split.train | held.split.test]
    missed = held.residuals.beam_rad[tested]
    noise = 0.5 * prediction.sigma_noise_rad**2
    covariance = prediction.covariance_rad2 + noise[:, None, None] * np.eye(2)
    known = np.isfinite(missed).all(axis=1) & held.residuals.computable[tested]
    missed, covariance = missed[known], covariance[known]
    squared = np.sum(missed**2, axis=1)
    distance = np.einsum("ni,nij,nj->n", missed, np.linalg.inv(covariance), missed)
    return 1e3 * float(np.sqrt(squared.mean())), float(np.sum(distance < _INSIDE_95)), int(known.sum())


def main() -> None:
    if sys.argv[1:2] == ["real"]:
        with tempfile.TemporaryDirectory() as place:
            csp = ROOT.parent / "shared" / "data" / "csp"
            real(Path(sys.argv[2]) if len(sys.argv) > 2 else joined(Path(place), [csp / name for name in REAL]))
        return
    heliostats, observations = (int(one) for one in sys.argv[1:3]) if len(sys.argv) > 2 else (300, 100)
    # The first one imports scipy.
    plain_fit_s()
    print(f"{heliostats} and {2 * heliostats} heliostats x {observations} observations, --quick")
    print(f"{'':10}{'heliostats':>12}{'wall s':>10}{'CPU s':>10}{'MiB':>8}{'CPU ms each':>14}{'plain fit ms':>14}")
    with tempfile.TemporaryDirectory() as place:
        found = {}
        for size in (heliostats, 2 * heliostats):
            write_field(Path(place) / f"in{size}", size, observations)
            for jobs in (1, 2):
                out = Path(place) / f"out{size}_{jobs}"
                wall, cpu, memory, plain = calibrate(Path(place) / f"in{size}", out, jobs)
                found[size, jobs] = wall, cpu, plain
                each = f"{1e3 * cpu / size:>14.1f}{1e3 * plain:>14.1f}"
                print(f"--jobs {jobs:<3}{size:>12}{wall:>10.1f}{cpu:>10.1f}{memory:>8.0f}{each}", flush=True)
        for jobs in (1, 2):
            (wall, cpu, plain), (wall_2, cpu_2, plain_2) = found[heliostats, jobs], found[2 * heliostats, jobs]
            each, cpu_each = (wall_2 - wall) / heliostats, (cpu_2 - cpu) / heliostats
            # Both parts over the plain fit of their own time.
            fits = (cpu / plain + (cpu_2 / plain_2 - cpu / plain) / heliostats * (ASKED - heliostats)) / ASKED
            print(
                f"--jobs {jobs}: {1e3 * each:.1f} ms wall and {1e3 * cpu_each:.1f} ms CPU for each more; {ASKED} take "
                f"{(wall + each * (ASKED - heliostats)) / 60:.1f} min wall ({ASKED * cpu_each / 60 / jobs:.1f} min on "
                f"{jobs} free cores), asked {MINUTES:.0f} on 2; CPU of each over one plain fit {fits:.2f} (1.5)"
            )


if __name__ == "__main__":
    main()
