"""How a mirror turns from frame to frame: where the next one is expected, and how sure that is."""

from dataclasses import dataclass, field

import numpy as np

from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector, vector_from_rotation
from heliogauge.validate import FloatArray

#: Predictions whose misses say how far the next one may be off.
_REMEMBERED = 20
#: Of the turn that moves the pattern by one dot: how far the second frame may be off the first, 1 sigma, and how near
#: any prediction is believed to be at best.
_FIRST_SHARE, _LEAST_SHARE = 0.2, 0.02


@dataclass(slots=True, eq=False)
class Motion:
    """Poses of the frames that were measured, and the misses of their predictions.

    step_rad: Turn of the mirror that moves the pattern by one dot [rad].
    """

    step_rad: float
    _frames: list[tuple[float, RigidTransform]] = field(default_factory=list)
    _misses_rad: list[float] = field(default_factory=list)
    _lost: int = 0

    def predicted(self, time_s: float) -> RigidTransform:
        """Return the pose at a time, from the last two frames: the mirror keeps turning as it did."""
        latest_s, latest = self._frames[-1]
        if len(self._frames) < 2:
            return latest
        before_s, before = self._frames[-2]
        turn = vector_from_rotation(latest.rotation @ before.rotation.T)
        # Over a gap of frames that were not measured a speed would lead far off.
        share = min((time_s - latest_s) / (latest_s - before_s), 1.0)
        return RigidTransform(rotation_from_vector(share * turn) @ latest.rotation, latest.translation_m)

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of the turn that the prediction does not know, in each direction [rad]."""
        known = np.array([_FIRST_SHARE * self.step_rad, *self._misses_rad[-_REMEMBERED:]])
        # Misses are lengths of two directions.
        sigma = float(np.sqrt(0.5 * np.mean(known**2)))
        return max(sigma, _LEAST_SHARE * self.step_rad) * (1.0 + self._lost)

    def add(self, time_s: float, pose: RigidTransform) -> float:
        """Add a frame that was measured; return the miss of its prediction [rad], 0 for the first."""
        miss = 0.0
        if self._frames:
            off: FloatArray = pose.rotation[:, 2] - self.predicted(time_s).rotation[:, 2]
            miss = float(np.linalg.norm(off))
            self._misses_rad.append(miss)
        self._frames.append((time_s, pose))
        self._lost = 0
        return miss

    def lose(self) -> None:
        """Note a frame that was not measured: the next one is less sure."""
        self._lost += 1
