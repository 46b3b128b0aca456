"""Exports of calibrated heliostats, evaluated with the other program's own equations.

Run: python benchmarks/heliostat_exports.py RESULTS (of `heliogauge heliostat measure`, linear actuators).
ARTIST is on no package index: its equations are those of its source, written apart for the tests in double precision.
Asked: beams of the export differ from the calibrated model by no more than what exported.csv states.
"""

import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
from _heliostats import line, title

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from calibration.heliostat.exports.working_range import WorkingRange
from calibration.heliostat.files.store_heliostat import read_results, stored_site
from calibration.heliostat.kinematic_model import mirror_poses
from calibration.heliostat.kinematic_model.store_design import design_from
from calibration.heliostat.pipeline.export import run
from heliogauge.geometry.rays import reflect
from heliogauge.results.tables import read_table_csv
from tests.calibration import artist_equations as artist


def differences_mrad(theirs, design, at):
    """Beams of ARTIST's equations beside those of the calibrated model, at the same readings and suns."""
    normals, centres = theirs.mirror(at.readings)
    poses = mirror_poses(design, design.parameters.values, at.readings)
    ours = reflect(-at.suns, poses.normals(design))
    apart = centres - poses.centre_m
    across = apart - np.sum(apart * ours, axis=1, keepdims=True) * ours
    distance = np.linalg.norm(at.aim_points_m - poses.centre_m, axis=1, keepdims=True)
    return 1e3 * np.linalg.norm(reflect(-at.suns, normals) - ours + across / distance, axis=1)


def main(results: Path) -> None:
    title(
        "ARTIST's equations on artist_heliostats.h5: beam beside the calibrated model [mrad], RMS and largest of a year"
    )
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "artist"
        run(results, out, "artist")
        table = read_table_csv(out / "exported.csv")
        stated = {
            (name, file): (float(rms), float(largest), status)
            for name, file, rms, largest, status in zip(
                *(table[key] for key in ("heliostat", "file", "loss_rms_mrad", "loss_largest_mrad", "status")),
                strict=True,
            )
            if rms
        }
        with h5py.File(out / "artist_heliostats.h5") as file:
            for content in read_results(results):
                design = design_from(content["design"], content["parameters"], key="value")
                points = [one["center_m"] for one in content["targets"].values()]
                # Neither the suns that the export was adjusted to nor those by which its loss was found.
                at = WorkingRange.of(design, stored_site(content), points, day_of_month=3, per_day=9)
                found = differences_mrad(artist.from_scenario(file, design.name), design, at)
                rms, largest, _ = stated[design.name, "artist_heliostats.h5"]
                measured = f"{np.sqrt(np.mean(found**2)):.4f}, {found.max():.4f}"
                # Other suns may lie a little beyond those by which the loss was found.
                holds = bool(np.sqrt(np.mean(found**2)) <= 1.1 * rms and found.max() <= 1.25 * largest)
                line(design.name, f"{rms:.4f}, {largest:.4f}", measured, holds)
                lost, _, status = stated[design.name, f"{design.name}_properties.json"]
                line(
                    f"{design.name}_properties.json, without tilts",
                    "within the limit, or refused",
                    f"{lost:.2f}",
                    status,
                )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
