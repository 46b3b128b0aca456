"""What comes of two results of one mirror that are compared."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from deflectometry.comparison.canting_difference import CantingDifference
from deflectometry.comparison.judgement import SIGNIFICANCE, Agreement, Judgement, SelfCheck, focal_words
from deflectometry.comparison.linear_terms import ExpectedRest, LinearTerms
from deflectometry.comparison.placing import Placed
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import Summary, write_slope_map, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.slopes.map import SlopeMap

KIND = "deflectometry-compare"
MAPS_FILE, TERMS_FILE, CHECKS_FILE, CANTINGS_FILE = "maps.nc", "terms.csv", "own_data.csv", "canting_difference.csv"
#: Groups of `MAPS_FILE`.
FIRST, SECOND, DIFFERENCE, REST = "first", "second", "difference", "difference without linear terms"


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One of the two results.

    name: What the reader calls it.
    folder, summary, slope_map: Where it is, its numbers, its map.
    """

    name: str
    folder: Path
    summary: Summary
    slope_map: SlopeMap


@dataclass(frozen=True, slots=True, eq=False)
class Comparison(InstrumentResult):
    """Two results of one mirror against each other.

    sides: The first and the second.
    placed: How the second was placed.
    maps: The first, the second on its grid, first minus second, and that without its linear terms.
    own_terms: Linear terms of either map's slopes.
    terms, stated: Linear terms of the difference, with all sigmas and with those as stated.
    rest: What the sigmas leave beside the linear terms.
    checks: What their own data say.
    judgement: Whether they agree.
    cantings: Canting of single facets; None where both have not measured two of the same names.
    """

    kind: ClassVar[str] = KIND
    sides: tuple[Side, Side]
    placed: Placed
    maps: Mapping[str, SlopeMap]
    own_terms: tuple[LinearTerms, LinearTerms]
    terms: LinearTerms
    stated: LinearTerms
    rest: ExpectedRest
    checks: tuple[SelfCheck, SelfCheck]
    judgement: Judgement
    cantings: CantingDifference | None

    @property
    def agrees(self) -> bool:
        """Whether the two results agree within their sigmas, canting of facets included."""
        if self.cantings is not None and self.cantings.probability < SIGNIFICANCE:
            return False
        return self.judgement.agreement in (Agreement.WITHIN, Agreement.WITHIN_ENLARGED)

    @property
    def exit_code(self) -> int:
        """1 where the two contradict each other."""
        return 0 if self.agrees else 1

    def summarise(self) -> Summary:
        """Collect the numbers of the difference with their sigmas."""
        numbers: dict[str, float | int | None] = {}
        axes = "xy"[: len(self.terms.rest)]
        for axis, rms in zip(axes, self._difference_rms(), strict=True):
            numbers[f"difference_{axis}_rms_rad"] = rms
        expected = np.sqrt(self.rest.mean_square)
        for axis, rms, one in zip(axes, self.terms.rest_rms_rad, expected, strict=True):
            numbers[f"rest_{axis}_rms_rad"] = float(rms)
            numbers[f"rest_{axis}_expected_rms_rad"] = float(one)
        for name, value, sigma, bare in zip(
            self.terms.names, self.terms.values, self.terms.sigmas, self.stated.sigmas, strict=True
        ):
            unit = unit_of_term(name)
            numbers[f"{name}_difference{unit}"] = float(value)
            numbers[f"sigma_{name}_difference{unit}"] = float(sigma)
            numbers[f"sigma_as_stated_{name}_difference{unit}"] = float(bare)
        reasons = {}
        judged = self.judgement
        for key, value in (
            ("terms_agreement_probability", judged.terms_probability),
            ("terms_as_stated_agreement_probability", judged.stated_probability),
            ("rest_agreement_probability", judged.rest_probability),
            ("fine_structure_correlation_ratio", self.placed.likeness.correlation),
        ):
            numbers[key] = value if np.isfinite(value) else None
            if not np.isfinite(value):
                reasons[key] = "no sigma" if "agreement" in key else "the fine structure is below the noise"
        if self.placed.found is not None:
            found = self.placed.found
            for name, value, sigma in zip(
                ("turn_rad", "shift_x_m", "shift_y_m"),
                (found.motion.turn_rad, *found.motion.shift_m),
                found.sigmas,
                strict=True,
            ):
                numbers[f"in_plane_{name}"], numbers[f"sigma_in_plane_{name}"] = float(value), float(sigma)
        if (canted := self.cantings) is not None:
            for axis, off, sigma in zip("xy", canted.difference_rad.T, canted.sigma_rad.T, strict=True):
                numbers[f"canting_difference_{axis}_rms_rad"] = float(np.sqrt(np.mean(off**2)))
                numbers[f"canting_difference_{axis}_expected_rms_rad"] = float(np.sqrt(np.mean(sigma**2)))
            numbers["canting_agreement_probability"] = canted.probability if np.isfinite(canted.probability) else None
            if not np.isfinite(canted.probability):
                reasons["canting_agreement_probability"] = "no sigma"
        numbers["nodes_count"] = self.terms.rest.shape[1]
        texts = {
            "first": f"{self.sides[0].name} ({self.sides[0].summary.kind})",
            "second": f"{self.sides[1].name} ({self.sides[1].summary.kind})",
            "verdict": self.verdict(),
            "placed": self.placed_words(),
            "difference": "first minus second; slopes of the normal, a beam turns by twice as much",
        }
        if self.cantings is not None:
            texts["canting"] = self.canting_words()
        return self._summary(numbers, texts, reasons)

    def canting_words(self) -> str:
        """Say how the canting of single facets differs; empty where it was not compared."""
        if (one := self.cantings) is None:
            return ""
        off, made = (1e3 * float(np.sqrt(np.mean(values**2))) for values in (one.difference_rad, one.sigma_rad))
        verdict = "no sigma"
        if np.isfinite(one.probability):
            verdict = "contradict" if one.probability < SIGNIFICANCE else "agree within their sigmas"
        return (
            f"canting of {len(one.names)} facets against their mean: {off:.3f} mrad RMS apart, the sigmas make "
            f"{made:.3f}: {verdict}"
        )

    def _difference_rms(self) -> list[float]:
        change = self.maps[DIFFERENCE]
        known = change.valid
        return [
            float(np.sqrt(np.mean(one[known] ** 2))) for one in (change.slope_x, change.slope_y)[: len(self.terms.rest)]
        ]

    def placed_words(self) -> str:
        """Say how the second map was placed in the frame of the first."""
        found = self.placed.found
        motion = self.placed.motion
        if not self.placed.is_moved:
            if found is None:
                return "both frames as they are: the slopes have no fine structure to place them by"
            offs = [
                f"{name} {number_text(value, sigma, unit)}"
                for name, value, sigma, unit in zip(
                    ("turn", "x", "y"),
                    (found.motion.turn_rad, *found.motion.shift_m),
                    found.sigmas,
                    ("rad", "m", "m"),
                    strict=True,
                )
            ]
            return f"both frames as they are (by the slopes: {', '.join(offs)})"
        sigmas = np.full(3, np.nan) if found is None else found.sigmas
        turn = np.degrees(motion.turn_rad)
        return (
            f"second map turned by {turn:.3f} +- {np.degrees(sigmas[0]):.3f} deg and moved by "
            f"{1e3 * motion.shift_m[0]:.1f} +- {1e3 * sigmas[1]:.1f} mm in x, {1e3 * motion.shift_m[1]:.1f} +- "
            f"{1e3 * sigmas[2]:.1f} mm in y, as the fine structure of the slopes has it"
        )

    def verdict(self) -> str:
        """Say in words whether the two agree, which terms contradict, and which result contradicts its own data."""
        judged, (first, second) = self.judgement, (one.name for one in self.sides)
        if judged.agreement is Agreement.UNKNOWN:
            return "neither result has a sigma: the difference is known, whether it is too large is not"
        if judged.agreement is Agreement.WITHIN:
            return f"{first} and {second} agree within their sigmas"
        said = [
            f"{first} and {second} contradict each other"
            if judged.agreement is Agreement.CONTRADICT
            else f"{first} and {second} agree only because sigmas were enlarged where data contradict themselves"
        ]
        if judged.contradicting:
            parts = ", ".join(f"{_spoken(name)} ({factor:.3g})" for name, factor in judged.contradicting.items())
            said.append(f"beyond the sigmas as stated (times sigma): {parts}")
        if (opposite := self._opposite()) != "":
            said.append(opposite)
        if judged.rest_probability < 0.5 * SIGNIFICANCE:
            factors = " and ".join(f"{one:.3g}" for one in self.terms.rest_rms_rad / np.sqrt(self.rest.mean_square))
            too = ", too" if judged.contradicting else ""
            said.append(f"what is left beside linear terms is more than the sigmas make ({factors} times){too}")
        if judged.blamed:
            check = next(one for one in self.checks if one.name == judged.blamed)
            share = f" ({100 * judged.share:.3g} % of the squared curl of both)" if np.isfinite(judged.share) else ""
            said.append(f"{check.name} contradicts its own data{share}: {check.words()}")
        elif all(one.contradicts_itself for one in self.checks):
            said.append("both contradict their own data")
        else:
            said.append("neither contradicts its own data so that the other could be believed")
        return "; ".join(said)

    def _opposite(self) -> str:
        names = self.terms.names
        signs = [
            (one, two)
            for name, one, two in zip(names, self.own_terms[0].values, self.own_terms[1].values, strict=True)
            if name.startswith("curvature") and name in self.judgement.contradicting and one * two < 0
        ]
        if not signs:
            return ""
        focal = (focal_words(one.values, names) for one in self.own_terms)
        return "focal lengths of opposite sign: " + " against ".join(focal)

    def write_files(self, folder: Path) -> None:
        """Write maps and tables into an existing folder."""
        write_slope_map(folder / MAPS_FILE, {"": self.maps[DIFFERENCE], **self.maps}, {"name": self.name})
        write_table_csv(
            folder / TERMS_FILE,
            {
                "term": self.terms.names,
                "unit": ["rad" if unit_of_term(name) == "_rad" else "1/m" for name in self.terms.names],
                "first": self.own_terms[0].values,
                "sigma_first": self.own_terms[0].sigmas,
                "second": self.own_terms[1].values,
                "sigma_second": self.own_terms[1].sigmas,
                "difference": self.terms.values,
                "sigma_difference": self.terms.sigmas,
                "sigma_difference_as_stated": self.stated.sigmas,
                "contradicts": ["yes" if name in self.judgement.contradicting else "" for name in self.terms.names],
            },
        )
        fields = ("curl_per_m", "sigma_curl_per_m", "smooth_curl_per_m", "smooth_curl_ratio", "turn_rad")
        columns: dict[str, Sequence[object]] = {"result": [one.name for one in self.checks]}
        columns |= {name: [getattr(one, name) for one in self.checks] for name in fields}
        columns["serious_doubts"] = [" / ".join(one.serious) for one in self.checks]
        write_table_csv(folder / CHECKS_FILE, columns)
        if (canted := self.cantings) is not None:
            table: dict[str, Sequence[object]] = {"facet": canted.names}
            for name in ("first", "second", "difference", "sigma"):
                for axis, values in zip("xy", getattr(canted, f"{name}_rad").T.tolist(), strict=True):
                    table[f"{name}_{axis}_rad"] = values
            write_table_csv(folder / CANTINGS_FILE, table)

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        first, second = (one.name for one in self.sides)
        rms = "   ".join(f"{axis} {1e3 * one:.3f}" for axis, one in zip("xy", self._difference_rms(), strict=False))
        rest = "   ".join(
            f"{axis} {1e3 * one:.3f} (sigmas make {1e3 * two:.3f})"
            for axis, one, two in zip("xy", self.terms.rest_rms_rad, np.sqrt(self.rest.mean_square), strict=False)
        )
        lines = [
            f"{first} minus {second}, slopes of the normal at {self.terms.rest.shape[1]} nodes",
            f"  as they are        RMS {rms} mrad",
            f"  beside linear terms RMS {rest} mrad",
        ]
        for name, value, sigma, bare in zip(
            self.terms.names, self.terms.values, self.terms.sigmas, self.stated.sigmas, strict=True
        ):
            unit = "mrad" if unit_of_term(name) == "_rad" else "mrad/m"
            own = [float(one.values[self.terms.names.index(name)]) * 1e3 for one in self.own_terms]
            # Two digits of the sigma, a thousandth of a milliradian at least.
            places = 3 if not sigma > 0 else max(3, 1 - int(np.floor(np.log10(1e3 * sigma))))
            numbers = (*own, *(1e3 * one for one in (value, sigma, bare)))
            one, two, off, scatter, as_stated = (f"{number:z.{places}f}" for number in numbers)
            lines.append(
                f"  {_spoken(name):18s} {one} against {two}: {off} +- {scatter} {unit} (+- {as_stated} as stated)"
            )
        lines += [f"  own data of {one.name}: {one.words()}" for one in self.checks]
        if self.cantings is not None:
            lines.append(f"  {self.canting_words()}")
        lines += [f"  {self.placed_words()}", f"  verdict: {self.verdict()}"]
        return "\n".join(lines)


def _spoken(name: str) -> str:
    return name.replace("_", " ")


def unit_of_term(name: str) -> str:
    """Return the ending of the key of a linear term."""
    return "_rad" if name.startswith("tilt") else "_per_m"
