"""Frames to display points at full size, against the plain route: np.interp on the whole stack, arctan2, np.round.

Run: OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/phase.py
Prints CPU seconds (best of three) and the peak memory beyond the frames, both routes in the same run.
"""

import resource
import time
import tracemalloc
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from calibration.screen import ScreenResponse, linearise_frames
from deflectometry.frames import check_frames
from deflectometry.fringes import measure_screen_map, modulation_image
from deflectometry.setup import Axis, FringePattern, make_pattern

HEIGHT, WIDTH = 1232, 1624
PERIODS = [0.9, 3.9, 15.9, 63.9]


def draw_frames(pattern: FringePattern, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Draw noisy frames of a mirror that shows the whole display."""
    u = np.linspace(0, 1, WIDTH, dtype=np.float32)[None, :]
    v = np.linspace(0, 1, HEIGHT, dtype=np.float32)[:, None]
    frames = np.empty((pattern.n_frames, HEIGHT, WIDTH), dtype=np.uint8)
    for fringes, place in zip(pattern.sets, pattern.frame_slices, strict=True):
        position = u if fringes.axis is Axis.X else v
        for index, step in zip(range(place.start, place.stop), fringes.steps_rad, strict=True):
            wave = 110 + 90 * np.cos(2 * np.pi * fringes.periods * position - step)
            noisy = wave + rng.standard_normal((HEIGHT, WIDTH), dtype=np.float32)
            frames[index] = np.rint(noisy)
    return frames


def plain_route(frames: npt.NDArray[np.uint8], response: ScreenResponse | None) -> list[npt.NDArray[np.float64]]:
    """Whole-stack arithmetic in float64 with the finest set alone, no sigma, no flags."""
    stack = frames.astype(np.float64)
    if response is not None:
        stack = np.interp(frames, response.camera_dn, response.display_level)
    positions = []
    position = np.zeros(0)
    for start in (0, 16):
        for index, periods in enumerate(PERIODS):
            one = stack[start + 4 * index : start + 4 * index + 4]
            turns = np.arctan2(one[1] - one[3], one[0] - one[2]) / (2 * np.pi) % 1
            position = turns / periods if index == 0 else (np.round(periods * position - turns) + turns) / periods
        positions.append(position)
    return positions


def measure(name: str, work: Callable[[], object]) -> None:
    """Print CPU time and peak memory of some work."""
    seconds = []
    for _ in range(3):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    print(f"{name:54s} {min(seconds):7.3f} s CPU (first {seconds[0]:.3f})  {peak / 2**20:7.0f} MiB")


def main() -> None:
    """Run all."""
    pattern = make_pattern(PERIODS, PERIODS)
    frames = draw_frames(pattern, np.random.default_rng(1))
    transposed = np.ascontiguousarray(frames.transpose(1, 2, 0)).transpose(2, 0, 1)
    levels = np.linspace(0, 255, 27)
    response = ScreenResponse(levels, 255 * (levels / 255) ** 0.8)
    print(f"{frames.shape} {frames.dtype}, {frames.nbytes / 2**20:.0f} MiB")
    measure("frames to display points", lambda: measure_screen_map(frames, pattern))
    measure("the same, stored as (h, w, n)", lambda: measure_screen_map(transposed, pattern))
    measure("the same, with a response", lambda: measure_screen_map(frames, pattern, response=response))
    measure("plain whole-stack route", lambda: plain_route(frames, None))
    measure("plain whole-stack route, with a response", lambda: plain_route(frames, response))
    measure("response of all frames by look-up", lambda: linearise_frames(frames, response))
    reused = np.empty(frames.shape, dtype=np.float32)
    measure("the same into an array in use", lambda: linearise_frames(frames, response, out=reused))
    measure(
        "response of all frames by np.interp",
        lambda: np.interp(frames, response.camera_dn, response.display_level).astype(np.float32),
    )
    measure("modulation image", lambda: modulation_image(frames, pattern))
    measure("frame checks", lambda: check_frames(frames, pattern))
    print(f"peak of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
