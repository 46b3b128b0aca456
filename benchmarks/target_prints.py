"""Ring codes as people print them: all codes of each dictionary, read by default settings, and their centres.

Each code of each dictionary is drawn once (`--all-kinds`: once of each kind), in turn of the kinds of prints, dots of 8
to 150 px, tilted by up to 45 deg. True centres are those of the ellipses that the dots' outlines make in the photo.
"""

import argparse
from dataclasses import dataclass, field

import numpy as np
from _measure import row, title

from data_synth.targets import PRINT_KINDS, render_photo, wall_scenes
from photogrammetry.detection import TargetSearch, measure_targets
from photogrammetry.targets import ring_dictionary

DICTIONARIES = ("aicon-12", "metashape-12", "aicon-14", "metashape-14")
SIZES_PX = ((8, 15), (15, 30), (30, 60), (60, 150))


@dataclass
class Tally:
    """What became of the codes of one kind."""

    shown: int = 0
    read: int = 0
    false: int = 0
    coarse: int = 0
    errors: list = field(default_factory=list)
    missed: list = field(default_factory=list)


def outline_centers(scene):
    """Centres of the ellipses that the dots' outlines make in the photo, by name; the camera has no distortion."""
    angles = np.arange(64) * (2 * np.pi / 64)
    view, centers = scene.views[0], {}
    for sheet in scene.sheets:
        radius = sheet.figure.diameter_m / 2
        circle = radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        line = view.project(sheet.world_from_sheet.apply(circle))
        middle = line.mean(axis=0)
        x, y = (line - middle).T
        a, b, c, d, e = np.linalg.lstsq(np.stack([x * x, x * y, y * y, x, y], axis=1), np.ones(64), rcond=None)[0]
        centers[sheet.name] = middle + np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e])
    return centers


def count(tally, scene, dictionary, rng):
    """Read one photo by default settings."""
    found = measure_targets(render_photo(scene, scene.views[0], rng), "wall", TargetSearch(dictionary))
    centers, diameters = outline_centers(scene), {one.name: one.figure.diameter_m for one in scene.sheets}
    read = set()
    for name, pixel, covariance, radius, flag in zip(
        found.detections.names,
        found.detections.pixels_px,
        found.detections.covariance_px2,
        found.detections.radius_px,
        found.detections.flags,
        strict=True,
    ):
        if name.startswith("u"):
            continue
        off = pixel - centers.get(name, np.inf)
        if not np.hypot(*off) < max(1.0, 0.1 * radius):
            tally.false += 1
            continue
        read.add(name)
        tally.coarse += bool(flag)
        tally.errors.append((2 * radius, *off, off @ np.linalg.solve(covariance, off)))
    tally.shown += len(centers)
    tally.read += len(read)
    tally.missed += [f"{name} ({1e3 * diameters[name]:.1f} mm)" for name in centers if name not in read]


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--dictionary", choices=DICTIONARIES, action="append")
    arguments.add_argument("--all-kinds", action="store_true")
    arguments.add_argument("--seed", type=int, default=0)
    chosen = arguments.parse_args()
    tallies = {kind: Tally() for kind in PRINT_KINDS}
    by_dictionary = {}
    for name in chosen.dictionary or DICTIONARIES:
        dictionary, rng = ring_dictionary(name), np.random.default_rng(chosen.seed)
        order = rng.permutation(len(dictionary))
        before = [(one.shown, one.read, one.false) for one in tallies.values()]
        for place, (kind, wall) in enumerate(PRINT_KINDS.items()):
            own = order if chosen.all_kinds else order[place :: len(PRINT_KINDS)]
            for scene in wall_scenes([dictionary.codes[k] for k in own], wall, rng):
                count(tallies[kind], scene, dictionary, rng)
        after = [(one.shown, one.read, one.false) for one in tallies.values()]
        by_dictionary[name] = np.sum(after, axis=0) - np.sum(before, axis=0)
    title("codes read by default settings", ("measured", "asked", ""))
    for name, (shown, read, false) in by_dictionary.items():
        row(f"{name}: read of {shown}; false", f"{read}; {false}", ">= 99 %; 0", "")
    for kind, tally in tallies.items():
        row(f"{kind}: read of {tally.shown}; false", f"{tally.read}; {tally.false}", ">= 99 %; 0", "")
        if tally.missed:
            row("  missed", ", ".join(tally.missed[:4]), "", "")
    title("centres: RMS of x and y [px]; chi-square / 2", ("measured", "asked", ""))
    for kind, tally in tallies.items():
        table = np.array(tally.errors).reshape(-1, 4)
        for low, high in SIZES_PX:
            own = table[(table[:, 0] >= low) & (table[:, 0] < high)]
            if len(own):
                rms, square = np.sqrt(np.mean(own[:, 1:3] ** 2)), own[:, 3].mean() / 2
                asked = "0.01; 1" if low <= 20 < high else "; 1"
                row(f"{kind}, {low} to {high} px ({len(own)})", f"{rms:.4f}; {square:.2f}", asked, "")


if __name__ == "__main__":
    main()
