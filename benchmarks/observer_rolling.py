"""Troughs photographed by a rolling shutter at 2 m/s: slopes, absorber and readout against the truth.

Run ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/observer_rolling.py FOLDER [PRESET=PHOTOS@SCALE ..]``,
for instance ``small=24@1 ls2=60@0.6``. FOLDER keeps the photos for the next run. Each seed is drawn with all rows read
at once, and in 20 and 30 ms; it is measured with the readout unknown, and without a word about it.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
from _measure import row, title
from observer_accuracy import absorber_error_mm, errors

from heliogauge.errors import MetrologyError
from heliogauge.measurement.load import load
from observer import Options, run

SPEED_M_S = 2.0
READOUTS_MS = (0.0, 20.0, 30.0)
SEEDS = (1, 2, 3)
STANDARD = ("small=24@1",)


def drawn(folder: Path, case: str, seed: int, readout_ms: float) -> Path:
    """Draw a preset unless it is there."""
    preset, _, rest = case.partition("=")
    photos, _, scale = rest.partition("@")
    place = folder / f"{preset}_{photos}_{scale}_{seed}_{readout_ms:g}ms"
    if not place.exists():
        command = ["-m", "heliogauge", "observer", "synth", str(place), "--preset", preset, "--photos", photos]
        command += ["--scale", scale, "--seed", str(seed), "--rolling-shutter-ms", str(readout_ms), "--quiet"]
        subprocess.run([sys.executable, *command], check=True)
    return place


def state(folder: Path, table: str) -> None:
    """Write what is said of the shutter to the end of a drawn measurement.toml, instead of what stood there."""
    file = folder / "measurement.toml"
    text = file.read_text(encoding="utf-8").partition("\n[rolling_shutter]")[0].rstrip()
    file.write_text(f"{text}\n{table}", encoding="utf-8")


def report(folder: Path, case: str, seed: int, readout_ms: float) -> None:
    place = drawn(folder, case, seed, readout_ms)
    title(f"{case}, seed {seed}, read in {readout_ms:g} ms at {SPEED_M_S:g} m/s", ("measured", "asked"))
    unknown = f"\n[rolling_shutter]\nspeed_m_s = {SPEED_M_S}\n"
    for name, table in (("readout unknown", unknown), ("nothing stated", "")):
        state(place, table)
        try:
            result = run(load(place), Options(jobs=1))
        except MetrologyError as error:
            row(name, "refused", "")
            print(f"  {error}")
            continue
        error, sigma, _ = errors(result, place)
        off_x, off_z = absorber_error_mm(result, place)
        row(f"{name}: slopes without tilt, RMS [mrad]", f"{1e3 * (error - error.mean()).std():.3f}", "as at 0 ms")
        row("  share of nodes with a value", f"{result.slope_map.measured_share:.2f}", "as at 0 ms")
        row("  mean of (error / sigma)^2", f"{np.mean((error / sigma) ** 2):.2f}", "")
        row("  absorber x, z, RMS error [mm]", f"{off_x:.2f}, {off_z:.2f}", "as at 0 ms")
        if result.motions is not None:
            found, uncertain = 1e3 * result.motions.readout, 1e3 * result.motions.sigma_readout
            row("  readout [ms]", f"{found:.2f} +- {uncertain:.2f}", f"{readout_ms:g}")
            row("  its error / sigma", f"{(found - readout_ms) / uncertain:.2f}", "")
        codes = sorted({one.code for one in result.doubts if one.code.startswith("rolling_shutter")})
        row("  doubts of the shutter", ", ".join(codes) or "none", "")


def main() -> None:
    folder, *cases = sys.argv[1:]
    for case in cases or STANDARD:
        for seed in SEEDS:
            for readout_ms in READOUTS_MS:
                report(Path(folder), case, seed, readout_ms)


if __name__ == "__main__":
    main()
