"""Diagnosis of real heliostats: healthy ones whole and in part, and with a fault of each kind drawn into their records.

Run: OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/heliostat_diagnosis.py [FIRST:LAST] [KIND ...]
Data: ../shared/data/csp/juelich_calibration and juelich_calibration_short (PAINT database).
Sizes come from sources that `_heliostat_faults.SIZES` names. Each drawn fault that a test at the significance in use
would see with a power of 95 % must be named with its kind and no other; a smaller one must not be named as another.
Seeds 100 to 105 are the test: nothing was ever chosen by them. Others are for development.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from _heliostat_faults import FAULTS, beams, by_values, is_detectable, judged, moved, sound, turned_sky, units
from _heliostats import line, title

from calibration.heliostat.diagnosis import judge_field
from heliogauge.errors import EstimationError

TEST = (100, 105)


# --- studies ----------------------------------------------------------------------------------------------------------


def healthy(seeds):
    accused, looked = [], 0
    rng = np.random.default_rng([seeds[0], 7])
    for name in sound():
        design, seen, plant = units()[name]
        parts = [np.ones(len(seen), dtype=bool)]
        order = np.argsort(seen.time)
        for _ in range((3 if len(seen) > 60 else 1) * len(seeds)):
            few = np.zeros(len(seen), dtype=bool)
            few[rng.choice(len(seen), int(rng.integers(min(8, len(seen)), min(len(seen), 60) + 1)), replace=False)] = (
                True
            )
            window = np.zeros(len(seen), dtype=bool)
            size = int(rng.integers(min(8, len(seen)), min(len(seen), 80) + 1))
            start = int(rng.integers(0, max(1, len(seen) - size)))
            window[order[start : start + size]] = True
            parts += [few, window]
        for part in parts:
            try:
                found = judged(design, seen.select(part), plant)
            except EstimationError:
                continue
            looked += 1
            if found.kinds:
                accused.append(f"{name} ({int(part.sum())} rows): {', '.join(found.kinds)}")
                print("    ", accused[-1], "|", found.faults[0].text)
    line(
        f"healthy: {len(sound())} units whole, {looked - len(sound())} parts",
        "0 accused",
        f"{len(accused)}",
        not accused,
    )


def drawn(seeds, kinds):
    """Print one line for each kind: what must be named, and what must not be taken for something else."""
    names = [one for one in sound() if len(units()[one][1]) > 60]
    total = dict.fromkeys(("right", "missed", "wrong", "below", "below wrong"), 0)
    heads = ("right", "missed", "other kind", "below: quiet", "below: other")
    print(f"  {'':30}" + "".join(f"{one:>14}" for one in heads))
    for kind, spoil in FAULTS.items():
        if kinds and kind not in kinds:
            continue
        counts, said = dict.fromkeys(total, 0), []
        wanted = kind.split()[0]
        for name in names:
            for seed in seeds:
                design, seen, plant, *before = spoil(name, np.random.default_rng([seed, 11]))
                found = judged(design, seen, plant)
                seeable = is_detectable(name, kind, design, seen, plant, *(before or [units()[name][1]]))
                others = [one for one in found.kinds if one != wanted]
                verdict = "wrong" if others else "right" if wanted in found.kinds else "missed"
                if not seeable:
                    verdict = "below wrong" if others else "below"
                counts[verdict] += 1
                if verdict not in ("right", "below"):
                    first = "; ".join(f"{one.kind} ({one.severity}) {one.text}" for one in found.findings[:3])
                    said.append(f"{verdict} {name}/{seed}: {first}")
        print(f"  {kind:30}" + "".join(f"{counts[key]:>14}" for key in total), flush=True)
        for one in said[:6]:
            print("      ", one[:420])
        total = {key: total[key] + counts[key] for key in total}
    right, must = total["right"], total["right"] + total["missed"] + total["wrong"]
    line("detectable faults named with their kind and no other", f"{must}", f"{right}", right == must)
    wrong = total["wrong"] + total["below wrong"]
    line("faults named as another kind, or as another too", "0", f"{wrong}", not wrong)


def of_field():
    """Compare six heliostats with the same fault, and one with five sound ones."""
    names = [one for one in sound() if len(units()[one][1]) > 60]
    wrong = "solar_tower_juelich_upper"

    def off(name):
        design, seen, plant = units()[name]
        labels = np.array(beams(seen).target)
        return judged(design, moved(seen, plant, np.where((labels == wrong)[:, None], [1.0, -0.8], 0.0)), plant)

    def late(name):
        design, seen, plant = units()[name]
        return judged(design, turned_sky(seen, plant.site, 3600.0), plant)

    def sound_one(name):
        return judged(*units()[name])

    def on_a_day(name, rng):
        design, seen, plant = units()[name]
        rows = seen.time >= np.datetime64("2023-06-01")
        size = rng.choice([-1, 1], 2) * rng.uniform(5e-3, 10e-3, 2)
        changes = {"tilt_1_u": size[0], "initial_angle_1": size[1]}
        return judged(design, moved(seen, plant, by_values(name, changes, rows)), plant)

    found = judge_field({name: off(name) for name in names})
    texts = [one.doubt.text for one in found.findings]
    line("a target 1.3 m off for six heliostats", "1 finding", f"{len(texts)}", len(texts) == 1)
    print("      ", *texts)
    alone = judge_field({name: off(name) if name == names[1] else sound_one(name) for name in names})
    faults = [kind for one in alone.changed.values() for kind in one.kinds]
    line("the same for one of six", "0 faults", f"{len(faults)}", not faults and bool(alone.changed))
    clock = judge_field({name: late(name) for name in names})
    texts = [one.doubt.text for one in clock.findings]
    line("a clock an hour off for six heliostats", "1 finding", f"{len(texts)}", len(texts) == 1)
    print("      ", *texts)
    rng = np.random.default_rng(5)
    day = judge_field({name: on_a_day(name, rng) if k < 4 else sound_one(name) for k, name in enumerate(names)})
    texts = [one.doubt.text for one in day.findings]
    line("four of six jump on one day", "1 finding", f"{len(texts)}", len(texts) == 1)
    print("      ", *texts)


def main():
    words = sys.argv[1:]
    first, last = (int(one) for one in words.pop(0).split(":")) if words and ":" in words[0] else TEST
    seeds = range(first, last + 1)
    title(f"diagnosis of real heliostats, seeds {first} to {last}")
    if not words or "healthy" in words:
        healthy(seeds)
    if not words or "field" in words:
        of_field()
    drawn(seeds, words)


if __name__ == "__main__":
    main()
