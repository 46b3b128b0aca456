"""What the benchmarks share: tables of measured beside asked, processor time by stage, synthetic input in memory."""

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.screen import ScreenResponse
from data_synth.fringes import FringeScene, Knowledge, measurement_content, response_table
from deflectometry.exchange import OpencspOptions, import_opencsp
from deflectometry.fringes import Observation, ScreenMapLimits
from deflectometry.pipeline import DeflectometryMeasurement, MirrorInput, build_setup, describe_mirror
from deflectometry.setup import Setup
from heliogauge.measurement.load import parse_measurement
from heliogauge.running.progress import RunningStage, SilentProgress

ROOT = Path(__file__).resolve().parents[1]
OPENCSP = ROOT.parent / "shared" / "data" / "opencsp"
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


def title(text: str, columns: tuple[str, ...] = ("measured", "asked", "incumbent")) -> None:
    print(f"\n{text}\n{'':62}" + "".join(f"{column:>18}" for column in columns))
    if any(os.environ.get(name) != value for name, value in ONE_THREAD.items()):
        print("(OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 are not set: CPU times hold the waiting of idle threads)")


def row(what: str, *values: str) -> None:
    print(f"  {what:60}" + "".join(f"{value:>18}" for value in values))


class StageClock(SilentProgress):
    """Processor time of each stage [s]; calls back when a stage begins."""

    def __init__(self, begins=None):
        super().__init__()
        self.cpu_s = {}
        self._begins = begins

    def started(self, stage: RunningStage) -> None:
        if self._begins is not None:
            self._begins(stage.name)
        self.cpu_s[stage.name] = self.cpu_s.get(stage.name, 0.0) - time.process_time()

    def finished(self, stage: RunningStage, duration_s: float) -> None:
        self.cpu_s[stage.name] += time.process_time()


@dataclass(frozen=True)
class CommandCost:
    """What a command took by the system's count: processor time [s], largest memory [MiB].

    What its parent has taken so far is a floor of its memory.
    """

    cpu_s: float
    mib: float


def command_cost(*arguments: str) -> CommandCost:
    """Run ``heliogauge`` as a process of its own, from start to end; compiled modules are kept, as installed."""
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, "-m", "heliogauge", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=environment)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"heliogauge {' '.join(arguments)}: status {process.returncode}")
    return CommandCost(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def evaluation_inputs(scene: FringeScene, knowledge: Knowledge, seed: int = 0) -> tuple[Setup, MirrorInput]:
    """Build what the measurement file would say of a scene, without the file."""
    content = measurement_content(scene, ["x.png"] * scene.pattern.n_frames, knowledge, np.random.default_rng(seed))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        measurement = DeflectometryMeasurement(folder, parse_measurement(content, folder / "measurement.toml"), ())
        setup = build_setup(measurement)
        return setup, describe_mirror(measurement, setup)


def observation_of(scene: FringeScene, fringes, *, response: bool = False) -> Observation:
    """Return the frames of a scene as they would be read."""
    return Observation(
        frames=fringes.frames,
        pattern=scene.pattern,
        response=response_of(scene) if response else None,
        lit=fringes.bright.astype(np.float32) - fringes.dark.astype(np.float32),
        limits=ScreenMapLimits(saturation_dn=float(scene.sensor.saturation_dn)),
    )


def response_of(scene: FringeScene) -> ScreenResponse:
    table = response_table(scene)
    return ScreenResponse(np.array(table["camera_dn"]), np.array(table["display_level"]))


#: What the publisher's own program made of the real facet.
EXPECTED = OPENCSP / "fringe" / "expected_facet" / "data.h5"


def import_real_facet(folder: Path, *, with_pose: bool) -> None:
    """Write the measurement folder of the published real facet, on request with the publisher's pose of the mirror."""
    files = [
        OPENCSP / "fringe" / "measurement_facet.h5",
        OPENCSP / "fringe" / "image_calibration.h5",
        OPENCSP / "common" / "camera_sofast_downsampled.h5",
        OPENCSP / "common" / "display_distorted_2d.h5",
        OPENCSP / "common" / "spatial_orientation.h5",
        OPENCSP / "common" / "Facet_NSTTF.json",
        EXPECTED,
    ]
    import_opencsp(files, folder, OpencspOptions(pose_from=EXPECTED if with_pose else None))
