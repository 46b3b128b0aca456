"""How many of a heliostat's numbers the observations support: nested choices tried out on blocks left aside."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.heliostat.fitting.fit_model import FitModel, descend
from calibration.heliostat.fitting.fit_result import FitOptions, HeliostatFit
from calibration.heliostat.fitting.prediction import sky_blocks
from calibration.heliostat.fitting.priors import ASKED_FOR, PARTS, prior_sigma, with_bending, with_priors
from calibration.heliostat.fitting.robust_fit import fit
from calibration.heliostat.kinematic_model.design import POSITION, HeliostatDesign
from calibration.heliostat.observations.observations import Observations
from heliogauge.errors import EstimationError, InputError
from heliogauge.validate import BoolArray, FloatArray

__all__ = ["Candidate", "CandidateScore", "ModelChoice", "choose_model", "usual_candidates", "with_priors"]

# Another choice must beat the usual one by more than the blocks could by chance.
_BETTER_BY = 0.1
# Two rows in each block.
_FEWEST = 8


@dataclass(frozen=True, slots=True)
class Candidate:
    """A choice of parameters that may move, with what is known of them.

    name: What it is called.
    sigmas: Prior sigma by parameter name (inf: free); all others are held.
    """

    name: str
    sigmas: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class CandidateScore:
    """How a candidate did.

    n_free: Its parameters.
    blocked_rms_rad: Beam error where blocks of sun positions had been left aside (normal error where no beam was
        seen) [rad].
    fit_rms_rad: The same in the fit to all rows [rad].
    aicc: Akaike's criterion for small samples of the fit to all rows.
    """

    name: str
    n_free: int
    blocked_rms_rad: float
    fit_rms_rad: float
    aicc: float


@dataclass(frozen=True, slots=True, eq=False)
class ModelChoice:
    """The choice and how it was made.

    design: The heliostat with the chosen parameters free within their priors.
    best: Name of the chosen candidate.
    table: All candidates, the smallest first.
    reason: Why it was chosen.
    """

    design: HeliostatDesign
    best: str
    table: tuple[CandidateScore, ...]
    reason: str


def usual_candidates(design: HeliostatDesign) -> tuple[Candidate, ...]:
    """Return nested choices for a design, each within its priors.

    design: The heliostat, with bending (`with_bending`) if that is to be tried.
    Returns: Nothing; headings and zeros; tilts; where it stands; bending; the parts of the drives. The usual one,
        all that is not part of a drive, is the last before the parts.
    InputError: None of the design's parameters is one of those that `PRIORS` knows.
    """
    tilts = ("tilt_1_n", "tilt_2_n", "tilt_north", "tilt_east", "tilt_about_east", "tilt_about_north")
    steps = (
        ("as delivered", ()),
        ("zeros", ("tilt_1_u", "tilt_2_e", "azimuth_offset", "elevation_offset")),
        ("tilts", (*tilts, "non_orthogonality", "canting")),
        ("place", POSITION),
        ("bending", ("sag_1", "sag_2")),
        ("parts", PARTS),
    )
    # What was asked for of the drives is no choice.
    sigmas = {name: prior_sigma(design, name) for name in ASKED_FOR if name in design.parameters.names}
    found: list[Candidate] = []
    for name, parameters in steps:
        new = {one: prior_sigma(design, one) for one in parameters if one in design.parameters.names}
        sigmas = sigmas | new
        if new or not parameters:
            found.append(Candidate(name, sigmas))
    if len(found) == 1:
        raise InputError(f"{design.name}: none of its parameters has a known prior; give candidates")
    return tuple(found)


def choose_model(
    design: HeliostatDesign,
    observations: Observations,
    options: FitOptions | None = None,
    candidates: Sequence[Candidate] | None = None,
) -> ModelChoice:
    """Choose which parameters may move by how well blocks of sun positions left aside are predicted.

    observations: What was seen.
    candidates: Choices, the smallest first; `usual_candidates` if not given.
    Returns: The chosen design and the table of all.
    EstimationError: No candidate could be fitted.
    InputError: There are no candidates.

    Rows are ordered by sun azimuth (by the first reading where there is no sun) and cut into four blocks; each is
    predicted from the other three. Leaving out single rows, or AICc, would ask how well the model fills gaps;
    left-out blocks ask how well it goes on where nothing was measured. Rows that a fit to all of them rejects are
    left out. Within priors a parameter too many costs little and one too few makes the others lie, so the usual
    choice stays unless another is better by a tenth. On six real heliostats with 30 suns of the morning only, the
    evening is predicted to 4.6 mrad in the median, 6.3 with the smallest choice within 5 %, 6.6 with four tilts set
    free.
    """
    bending = with_bending(design)
    tried = usual_candidates(bending) if candidates is None else tuple(candidates)
    if not tried:
        raise InputError("candidates: at least one choice of parameters is needed")
    everything = np.ones(len(observations), dtype=np.bool_)
    blocks = sky_blocks(observations, everything) if len(observations) >= _FEWEST else ()
    scores, designs = [], []
    for candidate in tried:
        held = bending.parameters.with_only_free(()).with_sigmas(candidate.sigmas)
        own = bending.with_parameters(held)
        try:
            scores.append(_score(candidate.name, own, observations, blocks, options))
        except EstimationError:
            continue
        designs.append(own)
    if not scores:
        raise EstimationError(f"{design.name}: none of {len(tried)} choices of parameters could be fitted")
    best = _chosen(scores)
    return ModelChoice(designs[best], scores[best].name, tuple(scores), _reason(scores, best, len(blocks)))


def _score(
    name: str,
    design: HeliostatDesign,
    observations: Observations,
    blocks: tuple[BoolArray, ...],
    options: FitOptions | None,
) -> CandidateScore:
    whole = fit(design, observations, options)
    # Near the answer already: one descent for each block, at the sigmas and with the rows of the whole fit.
    model = FitModel(whole.nominal, observations, options or FitOptions(), frozenset(whole.names))
    misses = []
    for block in blocks:
        part = descend(model, whole.solution.parameters, whole.sigma_factors, whole.used & ~block, 0.01)
        seen = model.evaluate(part.values)
        misses.append(_angles(seen.beam_angle_rad, seen.normal_angle_rad)[block & whole.used])
    own = _angles(whole.residuals.beam_angle_rad, whole.residuals.normal_angle_rad)[whole.used]
    blocked = _rms(np.concatenate(misses)) if misses else float("nan")
    return CandidateScore(name, whole.n_free, blocked, _rms(own), _aicc(whole))


def _angles(beam: FloatArray, normal: FloatArray) -> FloatArray:
    return np.where(np.isfinite(beam), beam, normal)


def _rms(angles: FloatArray) -> float:
    known = angles[np.isfinite(angles)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def _aicc(found: HeliostatFit) -> float:
    """Return n log(sum of squares / n) + 2 k + 2 k (k + 1) / (n - k - 1), with k parameters and the scatter."""
    components = found.residuals.whitened[found.used[found.residuals.owner]]
    n, k = components.size, found.n_free + 1
    if n <= k + 1:
        return float("inf")
    squares = max(float(np.sum(components**2)) / n, 1e-300)
    return float(n * np.log(squares) + 2 * k + 2 * k * (k + 1) / (n - k - 1))


def _chosen(scores: Sequence[CandidateScore]) -> int:
    """Return the usual choice unless another clearly predicts better what was left aside."""
    names = [score.name for score in scores]
    usual = len(scores) - 2 if names[-1] == "parts" and len(scores) > 1 else len(scores) - 1
    blocked = np.array([score.blocked_rms_rad for score in scores])
    if np.isnan(blocked).any():
        return usual
    best = int(np.argmin(blocked))
    return best if blocked[best] < (1 - _BETTER_BY) * blocked[usual] else usual


def _reason(scores: Sequence[CandidateScore], best: int, n_blocks: int) -> str:
    if not n_blocks:
        return "too few observations to leave any aside: everything within its prior but the parts of the drives"
    chosen = scores[best]
    text = f"predicts sun positions left aside to {1e3 * chosen.blocked_rms_rad:.2f} mrad"
    others = [f"{one.name} {1e3 * one.blocked_rms_rad:.2f}" for one in scores if one is not chosen]
    if not others:
        return text
    text = f"{text} ({', '.join(others)})"
    lowest = min(one.blocked_rms_rad for one in scores)
    if chosen.blocked_rms_rad > lowest:
        text += f"; the usual choice stays, since none is better by {100 * _BETTER_BY:.0f} %"
    return text
