"""CPU time and memory of the whole command on a facet, imports included, without the report.

Run ``python benchmarks/facet_command.py`` for 203 x 154 px x 32 frames, ``... full`` for 1624 x 1232 px, ``... large``
for the real frames with each pixel repeated 8 x 8 times: their outline contradicts the lens, so that what may be
exchanged is searched for. The small one
is the real facet where ../shared/data/opencsp is there, else a synthetic one of its size. User and system time of the
child process, one thread. With the root of another checkout as argument, the same command of that version is run too,
on what that version draws or imports (the same pixels; its measurement.toml has the keys that it knows).

OpenCSP is not on the Python package index and is not run here: its whole run took 1 / 1.3 of the processor time of
commit 12cdd87 on the same frames in the same run. With a checkout of that commit as argument, a ratio r to it is 1.3 r
to OpenCSP's.
"""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from _measure import ONE_THREAD, OPENCSP, ROOT, row, title

#: CPU [s] asked and the incumbent's, on the machine where both were run once.
SMALL, FULL = ("<= 1.0", "1.3"), ("<= 0.35 x OpenCSP's", "")
RUNS = 7


def child_cpu_s(environment, *arguments):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, *arguments], check=True, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def peak_mib(environment, *arguments):
    """Return the largest memory of a command, measured by a process between: that of all children is one number."""
    program = (
        "import resource, subprocess, sys; "
        "subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL); "
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024)"
    )
    command = [sys.executable, "-c", program, sys.executable, *arguments]
    return float(subprocess.run(command, check=True, env=environment, capture_output=True, text=True).stdout)


def measure(commands):
    """Return the CPU seconds of each command, run in turn so that other work on the machine meets all alike."""
    for environment, command in commands:
        child_cpu_s(environment, *command)  # compiles the modules, as installing does, and is not counted
    return np.array([[child_cpu_s(environment, *command) for environment, command in commands] for _ in range(RUNS)]).T


def surroundings(root, scratch):
    environment = {
        **os.environ,
        **ONE_THREAD,
        "PYTHONPATH": str(root),
        "PYTHONSAFEPATH": "1",  # else the version in the working directory would be measured
        "PYTHONPYCACHEPREFIX": f"{scratch}/bytecode",
    }
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    return environment


#: Writes the measurement as the version at the first argument does.
DRAW = """
import sys
from pathlib import Path
root, folder, size = sys.argv[1:]
sys.path.insert(0, f"{root}/benchmarks")
if size in ("real", "large"):
    from _measure import import_real_facet
    import_real_facet(Path(folder), with_pose=False)
    if size == "large":
        import re
        import cv2
        for file in Path(folder).glob("*.png"):
            image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(file), image.repeat(8, axis=0).repeat(8, axis=1))
        toml = Path(folder, "measurement.toml")
        text = re.sub(r"(?m)^((?:width|height)_px) = (.*)$", lambda m: f"{m[1]} = {8 * int(m[2])}", toml.read_text())
        text = re.sub(r"(?m)^(focal_._px) = (.*)$", lambda m: f"{m[1]} = {8 * float(m[2])!r}", text)
        toml.write_text(re.sub(r"(?m)^(center_._px) = (.*)$", lambda m: f"{m[1]} = {8 * float(m[2]) + 3.5}", text))
else:
    from data_synth.fringes import preset_scene, write_dataset
    write_dataset(Path(folder), preset_scene(size))
"""


def measuring(root, scratch, size):
    """Draw a measurement by a version of this project; return the command that evaluates it, with its environment."""
    place, environment = tempfile.mkdtemp(dir=scratch), surroundings(root, scratch)
    folder, out = f"{place}/measurement", f"{place}/result"
    subprocess.run([sys.executable, "-c", DRAW, str(root), folder, size], check=True, env=environment)
    return environment, ("-m", "heliogauge", "deflectometry", "measure", folder, "-o", out, "--no-report", "--force")


def main():
    is_large = "large" in sys.argv[1:] and OPENCSP.is_dir()
    is_full = "full" in sys.argv[1:] or is_large
    others = [Path(one).resolve() for one in sys.argv[1:] if one not in ("full", "large")]
    with tempfile.TemporaryDirectory() as scratch:
        if is_large:
            size, name = "large", "real facet, 1624 x 1232 px x 32 frames"
        elif is_full or not OPENCSP.is_dir():
            size = "full" if is_full else "small"
            name = f"synthetic facet, {'1624 x 1232' if is_full else '203 x 154'} px x 32 frames"
        else:
            size, name = "real", "real facet, pose from the outline, 203 x 154 px x 32 frames"
        title(f"Whole process, {name}: CPU s, median of {RUNS}", ("measured", "asked", "incumbent", "spread", "MiB"))
        here = surroundings(ROOT, scratch)
        libraries = "import numpy, cv2, h5py, pydantic, typer"
        what = "heliogauge deflectometry measure MEAS -o OUT --no-report"
        rows = {what: (*measuring(ROOT, scratch, size), FULL if is_full else SMALL)}
        rows |= {f"the same, {one}": (*measuring(one, scratch, size), ("", "")) for one in others}
        if not is_full:
            rows |= {
                "heliogauge --version": (here, ("-m", "heliogauge", "--version"), ("< 0.5", "")),
                "heliogauge --help": (here, ("-m", "heliogauge", "--help"), ("< 0.5", "")),
            }
        rows[f"beside it: {libraries}"] = (here, ("-c", libraries), ("", ""))
        times = measure([(environment, command) for environment, command, _ in rows.values()])
        for (what, (environment, command, asked)), seconds in zip(rows.items(), times, strict=True):
            peak = f"{peak_mib(environment, *command):.0f}"
            row(what, f"{np.median(seconds):.2f}", *asked, f"{seconds.min():.2f} to {seconds.max():.2f}", peak)
        if others:
            ratio = np.median(times[0] / times[1])
            row("ratio to the first other version, run by run", f"{ratio:.2f}")


if __name__ == "__main__":
    main()
