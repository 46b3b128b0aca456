"""From 32 frames of 1624 x 1232 px in memory to slopes with sigma: CPU time by stage, and memory beyond the frames.

Run with one thread: ``OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/deflectometry_speed.py``.
Beside it, in the same run, whole-array float64 numpy for phase and unwrapping alone, as it is usually first written.
"""

import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from _measure import (
    ONE_THREAD,
    ROOT,
    StageClock,
    evaluation_inputs,
    observation_of,
    response_of,
    row,
    title,
)

from data_synth.fringes import Knowledge, preset_scene, render_fringes
from deflectometry.frames import check_frames
from deflectometry.fringes import Observation
from deflectometry.pipeline import Choices, evaluate_source

ASKED_CPU_S, ASKED_MIB = 0.5, 300
INCUMBENT_CPU_S, INCUMBENT_MIB = 4.5, 1370
#: Other work on the machine only adds time: the fastest run counts, the median stands beside it.
REPEATS = 9
#: The slopes and their sigma are there when the maps begin.
TO_SLOPES = ("find mirror", "phase", "slopes", "uncertainty")
SIGMAS = {
    "sigma_focal_px": 0.3,
    "sigma_center_px": 0.3,
    "sigma_screen_rotation_mrad": 0.3,
    "sigma_screen_translation_mm": 2.0,
}
CASES = {
    "facet": (partial(preset_scene, "full"), Knowledge(**SIGMAS), "facet 1.2 m at 9.65 m, pose from the outline"),
    "large": (partial(preset_scene, "large"), Knowledge(**SIGMAS), "facet 2.4 m x 1.8 m fills two thirds of the frame"),
}


class Enough(Exception):  # noqa: N818
    """Ends an evaluation where the maps would begin."""


def to_slopes(observation, setup, mirror):
    def begins(stage):
        if stage == "maps":
            raise Enough

    clock = StageClock(begins)
    try:
        evaluate_source(observation, setup, mirror, Choices(), clock)
    except Enough:
        return clock.cpu_s
    raise RuntimeError("the stage of the maps has another name now")


def naive_screen_points(frames, pattern, response):
    """Look up, subtract, arctan2 and round on whole float64 arrays: no sigma, no flags, no slopes."""
    light = np.interp(frames.astype(np.float64), response.camera_dn, response.display_level)
    points = []
    for axis in {fringes.axis: None for fringes in pattern.sets}:
        fraction = None
        for fringes, place in sorted(pattern.sets_of(axis), key=lambda pair: pair[0].periods):
            first, second, third, fourth = light[place]
            turns = np.arctan2(second - fourth, first - third) / (2 * np.pi)
            if fraction is None:
                fraction = np.where(turns < 0, turns + 1, turns) / fringes.periods
            else:
                fraction = (turns + np.round(fraction * fringes.periods - turns)) / fringes.periods
        points.append(fraction)
    return points


def cpu_seconds(function):
    begin = time.process_time()
    function()
    return time.process_time() - begin


def measure_time(case, scene, observation):
    setup, mirror = evaluation_inputs(scene, CASES[case][1])
    with_response = replace(observation, response=response_of(scene))
    fastest, medians = {}, {}
    for label, one in (("with response look-up", with_response), ("frames as they are", observation)):
        runs = [to_slopes(one, setup, mirror) for _ in range(REPEATS)]
        totals = [total(run) for run in runs]
        fastest[label], medians[label] = runs[int(np.argmin(totals))], f"{np.median(totals):.3f}"
    clock = StageClock()
    evaluation = evaluate_source(with_response, setup, mirror, Choices(), clock)
    pixels = int(np.count_nonzero(evaluation.facet_index >= 0))
    title(f"{CASES[case][2]}: {pixels} px", ("CPU s", "asked", "incumbent", "median"))
    asked = (f"<= {ASKED_CPU_S}", f"{INCUMBENT_CPU_S}") if case == "facet" else ("", "")
    for label, run in fastest.items():
        row(f"frames to slopes with sigma, {label}", f"{total(run):.3f}", *asked, medians[label])
        for stage in TO_SLOPES:
            row(f"    {stage}", f"{run[stage]:.3f}")
    checks = [cpu_seconds(lambda: check_frames(observation.frames, observation.pattern)) for _ in range(REPEATS)]
    row("frame checks, before", f"{min(checks):.3f}", "", "", f"{np.median(checks):.3f}")
    nodes = next(iter(evaluation.maps.values())).aperture.size
    row(f"map of {nodes} nodes with height, after (one run)", f"{clock.cpu_s['maps']:.3f}")
    response = response_of(scene)
    naive = [cpu_seconds(lambda: naive_screen_points(observation.frames, scene.pattern, response)) for _ in range(3)]
    run = fastest["with response look-up"]
    row(
        "whole-array numpy: look-up, phase, unwrapping of all pixels",
        f"{min(naive):.3f}",
        "",
        "",
        f"{np.median(naive):.3f}",
    )
    row("    its ratio to the stage that does this here (phase)", f"{min(naive) / run['phase']:.1f} x")
    row("    its ratio to everything up to slopes with sigma", f"{min(naive) / total(run):.1f} x")


def total(run):
    return sum(run[stage] for stage in TO_SLOPES)


def resident_mib(key):
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(key):
            return int(line.split()[1]) / 1024
    raise RuntimeError(f"{key} is not in /proc/self/status")


def measure_memory(case, folder):
    """In a process of its own, so that the highest memory is that of this work."""
    scene = CASES[case][0]()
    setup, mirror = evaluation_inputs(scene, CASES[case][1])
    lit = np.load(folder / "lit.npy")
    observation = Observation(np.load(folder / "frames.npy"), scene.pattern, response_of(scene), lit)
    before = resident_mib("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the highest resident memory starts anew
    to_slopes(observation, setup, mirror)
    resident = resident_mib("VmHWM") - before
    traced = peak_of(lambda: to_slopes(observation, setup, mirror))
    naive = peak_of(lambda: naive_screen_points(observation.frames, scene.pattern, observation.response))
    maps = peak_of(lambda: evaluate_source(observation, setup, mirror, Choices(), StageClock()))
    title(
        f"{CASES[case][2]}: memory beyond the frames ({observation.frames.nbytes / 2**20:.0f} MiB)",
        ("MiB", "asked", "incumbent"),
    )
    asked = (f"<= {ASKED_MIB}", f"{INCUMBENT_MIB}") if case == "facet" else ()
    row("frames to slopes with sigma: allocated at once (tracemalloc)", f"{traced:.0f}", *asked)
    row("    resident memory of the process (first run)", f"{resident:.0f}", *asked)
    row("with the maps: allocated at once (tracemalloc)", f"{maps:.0f}")
    row("whole-array numpy, phase alone (tracemalloc)", f"{naive:.0f}")


def peak_of(function):
    tracemalloc.start()
    function()
    peak = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    return peak


def main():
    cv2.setNumThreads(1)
    if len(sys.argv) == 3:
        measure_memory(sys.argv[1], Path(sys.argv[2]))
        return
    for case, (make_scene, _, _) in CASES.items():
        scene = make_scene()
        observation = observation_of(scene, render_fringes(scene, np.random.default_rng(0)))
        measure_time(case, scene, observation)
        with tempfile.TemporaryDirectory() as scratch:
            np.save(Path(scratch) / "frames.npy", observation.frames)
            np.save(Path(scratch) / "lit.npy", observation.lit)
            environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(ROOT)}
            sys.stdout.flush()
            subprocess.run([sys.executable, __file__, case, scratch], check=True, env=environment)


if __name__ == "__main__":
    main()
