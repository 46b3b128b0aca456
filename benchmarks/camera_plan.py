"""Processor time of `heliogauge camera plan` for two photos, start included, after a drawn calibration."""

import os
import resource
import subprocess
import sys
import tempfile

from _measure import ONE_THREAD, ROOT, row, title


def cpu_s(*arguments: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-m", "heliogauge", "camera", *arguments], check=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        photos, result = f"{scratch}/photos", f"{scratch}/result"
        cpu_s("synth", photos, "--photos", "6", "--scale", "0.5", "-q")
        cpu_s("measure", photos, "-o", result, "--no-report", "-q")
        seconds = cpu_s("plan", result, "-o", f"{scratch}/plan", "--photos", "2", "--no-report", "-q")
        title("heliogauge camera plan: processor s", ("measured",))
        row("two photos after six of the preset's chessboard", f"{seconds:.1f}")


if __name__ == "__main__":
    main()
