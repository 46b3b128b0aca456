"""Promises of `heliogauge deflectometry plan` against drawn measurements: scatter over promise, promise over statement.

    python benchmarks/deflectometry_plan.py [--seeds 12] [--only fringes]

Each source is drawn so many times by `data_synth`, which shares no equation with estimator or plan, with set-ups stated
with errors of their sigmas. "joint": errors of both curvatures and of the mean normal together (of several facets: of
the mean normal) against the covariance promised before, root of chi-square over its number. "canting": errors of the
facets over their promised sigmas, RMS. "stated": promised sigma over the mean of those that measurements then state.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.deflectometry.planning.promises import (
    canting_ratio,
    drawn_dots,
    drawn_fringes,
    drawn_tower,
    joint_ratio,
    outcomes,
    promised_covariance,
)

SOURCES = {"fringes": drawn_fringes, "dots": drawn_dots, "tower": drawn_tower}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--only", choices=list(SOURCES))
    options = parser.parse_args()
    for name, source in SOURCES.items():
        if options.only in (None, name):
            _compare(name, source(), options.seeds)


def _compare(name: str, drawn: object, seeds: int) -> None:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        drawn.write(folder / "planned", seeds)
        prospect = drawn.promise(folder / "planned")
        found = list(outcomes(drawn, folder, seeds))
    print(f"{name}: joint {joint_ratio([one.errors for one in found], promised_covariance(prospect)):.2f}", end="")
    if found[0].canting_rad.size:
        print(f", canting {canting_ratio([one.canting_rad for one in found], prospect):.2f}", end="")
    promised = prospect.sigmas()
    said = [f"{key} {promised[key] / np.mean([one.stated[key] for one in found]):.2f}" for key in found[0].stated]
    print(f"; stated: {', '.join(said)}  ({seeds} seeds)")


if __name__ == "__main__":
    main()
