"""What a calibration found: camera, poses, shape of the board, how well, and what was left out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from calibration.camera.boards import Board
from calibration.camera.judgement.comparison import Comparison
from calibration.camera.judgement.network import Coverage
from calibration.camera.judgement.projection_sigma import RadialProfile, SigmaMap
from heliogauge.camera.model import Camera
from heliogauge.geometry.rigid import RigidTransform, skew
from heliogauge.results.frame import InstrumentResult
from heliogauge.validate import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class PhotoResult:
    """One photo.

    name: Its file.
    cam_from_board: Its pose.
    covariance (6, 6): Covariance of the steps of `RigidTransform.moved` [rad, m].
    index (n,): Points of the board that were measured.
    pixels_px (n, 2): Their places [px].
    residuals_px (n, 2): Predicted minus measured; NaN for rejected points [px].
    covariance_px2 (n, 2, 2): Of the measured places, as their fits give it [px^2].
    noise_ratio: Noise of its points over these.
    kept_apart_px: RMS of the residuals of all its points when camera and board come from the other photos and only
        its pose is fitted; NaN where that was not asked, infinite where no pose explains it [px].
    kept_apart_expected_px: What the covariance of camera and board from the others, the photo's own errors and noise
        let expect of it [px].
    """

    name: str
    cam_from_board: RigidTransform
    covariance: FloatArray
    index: IntArray
    pixels_px: FloatArray
    residuals_px: FloatArray
    covariance_px2: FloatArray
    noise_ratio: float
    kept_apart_px: float = float("nan")
    kept_apart_expected_px: float = float("nan")

    @property
    def used(self) -> BoolArray:
        """Points that were used, shape (n,)."""
        return np.asarray(np.isfinite(self.residuals_px[:, 0]))

    @property
    def rms_px(self) -> float:
        """RMS length of the residuals [px]."""
        return rms_length(self.residuals_px[self.used])


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutPhoto:
    """A photo that did not enter the calibration: camera and board explain it this well, only its pose is fitted.

    name: Its file.
    count: Points of the board.
    rms_px: RMS length of the residuals of all of them [px].
    """

    name: str
    cam_from_board: RigidTransform
    count: int
    rms_px: float


@dataclass(frozen=True, slots=True, eq=False)
class BoardShape:
    """The board as it is.

    board: As it was drawn.
    seen (k,): Its points that were measured.
    points_m (k, 3): Where they are [m].
    sigma_m (k, 3): Standard deviations [m].
    n_rays (k,): Photos that see each.
    prior_sigma_m (3,): How far points were allowed to be from the drawing, x, y and z; 0: held; infinite: nothing
        was known [m].
    datum: What defines the board's frame.
    """

    board: Board
    seen: IntArray
    points_m: FloatArray
    sigma_m: FloatArray
    n_rays: IntArray
    prior_sigma_m: FloatArray
    datum: str

    @property
    def has_drawing(self) -> bool:
        """Whether anything was known of the points' places before."""
        return not bool(np.isinf(self.prior_sigma_m).any())

    @property
    def departure_m(self) -> FloatArray:
        """Place less nominal place, shape (k, 3) [m]."""
        return np.asarray(self.points_m - self.board.points_m[self.seen])


@dataclass(frozen=True, slots=True, eq=False)
class CommonErrors:
    """What points have in common, as the photos gave it: standard deviations of the random effects.

    names: Of the groups of effects, those of the board's departure, of each photo's field and of the camera.
    effects (g,): Their sizes: of the board in pitches, of a photo in pixels, of its focal length as a share.
    point (3,): Of each point's own departure, x, y and z [pitches].
    pitch_m: Unit of the board's effects, its pitch [m].
    """

    names: tuple[str, ...]
    effects: FloatArray
    point: FloatArray
    pitch_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsic:
    """One estimated intrinsic with its test: ``significance`` is the probability that it differs from zero."""

    name: str
    value: float
    sigma: float
    significance: float
    rival: str
    correlation: float


@dataclass(frozen=True, slots=True, eq=False)
class Quality:
    """How well photos and model agree.

    rms_px: RMS length of the residuals with the board's shape estimated [px].
    rms_as_drawn_px: The same with the board held as it was drawn [px].
    sigma_factor_ratio: Residuals over what the pixels' noise lets expect; the stated sigmas contain it.
    redundancy: Residuals and prior knowledge less unknowns.
    rejected: Points that were left out, with their residual.
    """

    rms_px: float
    rms_as_drawn_px: float
    sigma_factor_ratio: float
    redundancy: int
    rejected: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Findings(InstrumentResult):
    """What a calibration found, without how it is written.

    camera_name: In cameras.json.
    camera: With its covariance.
    intrinsics: What was estimated.
    left_out: Photos that were not, with the reason.
    shape: The board.
    common: What points have in common.
    quality: Residuals.
    sigma: Uncertainty over the image.
    profile: Radial distortion.
    coverage: Where points were measured.
    held_out: Photos to check with.
    comparison: Against another calibration, if that was asked.
    thumbnails: Small JPEG of each photo, also of those left out.
    """

    kind: ClassVar[str] = "camera"
    camera_name: str
    camera: Camera
    intrinsics: tuple[Intrinsic, ...]
    photos: tuple[PhotoResult, ...]
    left_out: Mapping[str, str]
    shape: BoardShape
    common: CommonErrors
    quality: Quality
    sigma: SigmaMap
    profile: RadialProfile
    coverage: Coverage
    held_out: tuple[HeldOutPhoto, ...] = ()
    comparison: Comparison | None = None
    compared_with: Camera | None = None
    thumbnails: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def kept_apart_px(self) -> float:
        """RMS over all photos that were kept apart; NaN where none was [px]."""
        counts = np.array([photo.index.size for photo in self.photos], dtype=np.float64)
        values = np.array([photo.kept_apart_px for photo in self.photos])
        good = np.isfinite(values)
        if not good.any():
            return float("nan")
        return float(np.sqrt(np.sum(counts[good] * values[good] ** 2) / counts[good].sum()))

    @property
    def held_out_px(self) -> float:
        """RMS over all photos that were held out; NaN where there is none [px]."""
        counts = np.array([photo.count for photo in self.held_out], dtype=np.float64)
        if not counts.size:
            return float("nan")
        return float(np.sqrt(np.sum(counts * [photo.rms_px**2 for photo in self.held_out]) / counts.sum()))


def rms_length(residuals_px: FloatArray) -> float:
    """Return the RMS length of residuals, shape (n, 2) [px]."""
    return float(np.sqrt((residuals_px**2).sum(axis=1).mean())) if len(residuals_px) else float("nan")


def sigma_of_shape(points_m: FloatArray, covariance_m2: FloatArray) -> FloatArray:
    """Return the sigma of points after position, rotation and scale of the whole were taken out.

    Shapes: points_m (k, 3), covariance_m2 (3 k, 3 k).
    Returns (k, 3): Standard deviations under inner constraints [m].
    """
    arms = points_m - points_m.mean(axis=0)
    free = np.concatenate([np.tile(np.eye(3), (len(arms), 1, 1)), skew(arms), arms[:, :, None]], axis=2)
    basis, _ = np.linalg.qr(free.reshape(-1, 7))
    half = covariance_m2 @ basis
    own = np.diag(covariance_m2) - 2 * (half * basis).sum(axis=1) + ((basis @ (basis.T @ half)) * basis).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(own, 0.0)).reshape(-1, 3))
