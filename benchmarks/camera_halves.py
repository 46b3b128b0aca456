"""Is a camera's sigma true? Calibrations from disjoint halves of one board's photos, compared with their covariances.

Run with ``OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/camera_halves.py [SPLITS [BOARD]]``. Real boards
of ``../shared/data`` (OpenCV's chessboard held in the hand, six photos of 18 x 23 corners without roll) and drawn ones,
bent and sheared. Of each board as many ways to halve its photos as asked, all there are if fewer.
Chi-square per degree of freedom is that of ``heliogauge camera compare``: asked between 0.5 and 2.
"""

import itertools
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from calibration.camera import Options, compare, run
from data_synth.targets import PhotoOptions, board_scene, board_table, camera_content, write_target_dataset
from heliogauge.errors import EstimationError
from heliogauge.measurement.load import load

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
REAL = {
    "six photos, 18 x 23 corners": ("opencsp/camera_calibration", "*.png", 18, 23),
    "OpenCV's left01..14, 9 x 6 corners": ("photogrammetry/opencv_chessboard", "*.jpg", 9, 6),
}
DRAWN = ("chessboard", "charuco", "circles-asymmetric")


def halves(count: int, limit: int) -> list[tuple[list[int], list[int]]]:
    """Ways to halve photos; chosen by chance where there are more than asked."""
    size = count // 2
    ways = [way for way in itertools.combinations(range(count), size) if count % 2 or 0 in way]
    if len(ways) > limit:
        ways = [ways[i] for i in np.random.default_rng(0).choice(len(ways), limit, replace=False)]
    return [(list(way), [i for i in range(count) if i not in way]) for way in ways]


def calibrated(folder: Path, files: list[Path], content: str, options: Options):  # type: ignore[no-untyped-def]
    """Calibrate from some of the photos."""
    folder.mkdir()
    for file in files:
        shutil.copy(file, folder)
    (folder / "measurement.toml").write_text(content, encoding="utf-8")
    try:
        return run(load(folder), options)
    finally:
        shutil.rmtree(folder)


def examine(name: str, files: list[Path], content: str, place: Path, limit: int) -> None:
    begin = time.process_time()
    whole = calibrated(place / "whole", files, content, Options(jobs=1))
    shares, ratios, refused = [], [], 0
    for both in halves(len(files), limit):
        options = Options(jobs=1, leave_one_out=False)
        try:
            one, other = (calibrated(place / "half", [files[i] for i in half], content, options) for half in both)
        except EstimationError as error:
            refused += 1
            print(f"  {both[0]}: {str(error)[:100]}")
            continue
        found = compare(one.camera, other.camera)
        shares.append(found.chi_square / found.freedom)
        ratios.append(found.rms_rad / found.expected_rad)
    apart = np.array([photo.kept_apart_px / photo.kept_apart_expected_px for photo in whole.photos])
    print(f"{name}: {len(shares)} splits of {len(files)} photos, {refused} refused")
    print(f"  chi-square per degree of freedom   mean {np.mean(shares):.2f}, median {np.median(shares):.2f}")
    print("    each " + " ".join(f"{share:.2f}" for share in sorted(shares)))
    print(f"  lines of sight over expectation    RMS {np.sqrt(np.mean(np.square(ratios))):.2f}")
    print(
        f"  photos kept apart over expectation RMS {np.sqrt(np.nanmean(apart**2)):.2f}, largest {np.nanmax(apart):.2f}"
    )
    print(f"    {[one.code for one in whole.doubts]}; CPU {time.process_time() - begin:.0f} s", flush=True)


def main() -> None:
    if os.environ.get("OPENBLAS_NUM_THREADS") != "1":
        print("(OPENBLAS_NUM_THREADS=1 is not set: CPU times hold the waiting of idle threads)")
    limit = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    wanted = sys.argv[2] if len(sys.argv) > 2 else ""
    with tempfile.TemporaryDirectory() as folder:
        for name, (place, pattern, columns, rows) in REAL.items():
            files = sorted((SHARED / place).glob(pattern))
            content = (
                f'kind = "camera"\nname = "half"\n[board]\ntype = "chessboard"\ncolumns = {columns}\nrows = {rows}\n'
            )
            if files and wanted in name:
                examine(name, files, content + f'[images]\nphotos = "{pattern}"\n', Path(folder), limit)
        for seed, kind in enumerate(DRAWN):
            if wanted in f"drawn {kind}":
                own = Path(folder) / kind
                scene = board_scene(kind, seed, n_photos=10)
                write_target_dataset(own, scene, camera_content(scene, board_table(kind)), PhotoOptions(seed))
                content = (own / "measurement.toml").read_text(encoding="utf-8")
                examine(f"drawn {kind}", sorted(own.glob("*.png")), content, Path(folder), limit)


if __name__ == "__main__":
    main()
