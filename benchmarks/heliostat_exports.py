"""Exports of calibrated heliostats, evaluated with the other program's own equations.

Run: python benchmarks/heliostat_exports.py [RESULTS]; without RESULTS six heliostats of Juelich are calibrated first.
ARTIST is on no package index: its equations are those of its source, written apart for the tests in double precision.
Asked: beams of the export differ from the calibrated model by no more than what exported.csv states.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
from _heliostats import line, title

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from calibration.heliostat.exports import Calibrated, WorkingRange
from calibration.heliostat.kinematic_model import mirror_poses
from heliogauge.geometry.rays import reflect
from heliogauge.geometry.sun import Site
from heliogauge.results.tables import read_table_csv
from tests.calibration import artist_equations as artist
from tests.calibration.juelich import FOLDER, SOUND


def differences_mrad(theirs, design, at):
    """Beams of ARTIST's equations beside those of the calibrated model, at the same readings and suns."""
    normals, centres = theirs.mirror(at.readings)
    poses = mirror_poses(design, design.parameters.values, at.readings)
    ours = reflect(-at.suns, poses.normals(design))
    apart = centres - poses.centre_m
    across = apart - np.sum(apart * ours, axis=1, keepdims=True) * ours
    distance = np.linalg.norm(at.aim_points_m - poses.centre_m, axis=1, keepdims=True)
    return 1e3 * np.linalg.norm(reflect(-at.suns, normals) - ours + across / distance, axis=1)


def heliogauge(*words):
    subprocess.run([sys.executable, "-m", "heliogauge", "heliostat", *words, "-q"], check=True, capture_output=True)


def main(place: Path, results: Path | None) -> None:
    if results is None:
        results = place / "results"
        heliogauge("measure", str(FOLDER), "-o", str(results), "--only", ",".join(SOUND), "--no-report")
    title("ARTIST's equations on its files: beam beside the calibrated model [mrad], RMS and largest of a year")
    out = place / "artist"
    heliogauge("export", "artist", str(results), "-o", str(out))
    table = read_table_csv(out / "exported.csv")
    stated = {
        (name, file): (float(rms), float(largest), status)
        for name, file, rms, largest, status in zip(
            *(table[key] for key in ("heliostat", "file", "loss_rms_mrad", "loss_largest_mrad", "status")), strict=True
        )
        if rms
    }
    with h5py.File(out / "artist_heliostats.h5") as file:
        for path in sorted(results.glob("*/heliostat.json")):
            content = json.loads(path.read_text(encoding="utf-8"))
            known, site = Calibrated.from_content(content), Site(**content["site"])
            name, points = known.design.name, [one.center_m for one in known.targets.values()]
            # As many, but neither the suns that the export was adjusted to nor those by which its loss was found.
            at = WorkingRange.of(known.design, site, points, day_of_month=3, per_day=11)
            found = differences_mrad(artist.from_scenario(file, name), known.design, at)
            rms, largest, _ = stated[name, "artist_heliostats.h5"]
            measured = f"{np.sqrt(np.mean(found**2)):.4f}, {found.max():.4f}"
            # Other suns may lie a little beyond those by which the loss was found.
            holds = bool(np.sqrt(np.mean(found**2)) <= 1.1 * rms and found.max() <= 1.25 * largest)
            line(name, f"{rms:.4f}, {largest:.4f}", measured, holds)
            lost, _, status = stated[name, f"{name}_properties.json"]
            line(f"{name}_properties.json, without tilts", "within the limit, or refused", f"{lost:.2f}", status)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        main(Path(place), Path(sys.argv[1]) if len(sys.argv) > 1 else None)
