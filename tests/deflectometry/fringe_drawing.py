"""Frames of a mirror that shows fringes, drawn from the definition of the pattern alone."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from deflectometry.setup.patterns import Axis, FringePattern, FringeSet


@dataclass(frozen=True)
class Scene:
    """A mirror in the middle of the image; the display fills it but for a margin."""

    shape: tuple[int, int] = (160, 200)
    cover: float = 1.0
    offset_dn: float = 110.0
    modulation_dn: float = 90.0
    noise_dn: float = 1.0
    gain_dn: float = 0.0
    gamma: float = 1.0
    margin: float = 0.02

    def positions(self) -> tuple[np.ndarray, np.ndarray]:
        """Where on the display each pixel looks."""
        rows, columns = np.mgrid[0 : self.shape[0], 0 : self.shape[1]]
        u = self.margin + (1 - 2 * self.margin) * columns / (self.shape[1] - 1)
        v = self.margin + (1 - 2 * self.margin) * rows / (self.shape[0] - 1)
        return u, v

    def mirror(self) -> np.ndarray:
        """Pixels that show the display."""
        rows, columns = np.mgrid[0 : self.shape[0], 0 : self.shape[1]]
        half = 0.5 * np.sqrt(self.cover)
        return (abs(columns / (self.shape[1] - 1) - 0.5) <= half) & (abs(rows / (self.shape[0] - 1) - 0.5) <= half)

    def readings(
        self, pattern: FringePattern, rng: np.random.Generator, steps: Callable[[FringeSet], np.ndarray] | None = None
    ) -> np.ndarray:
        """Return noisy frames as float64; `steps` gives steps that differ from the planned ones."""
        u, v = self.positions()
        mirror = self.mirror()
        frames = []
        for fringes in pattern.sets:
            position = u if fringes.axis is Axis.X else v
            for step in fringes.steps_rad if steps is None else steps(fringes):
                wave = 0.5 + 0.5 * np.cos(2 * np.pi * fringes.periods * position - step)
                low = self.offset_dn - self.modulation_dn
                signal = np.where(mirror, low + 2 * self.modulation_dn * wave**self.gamma, 8.0)
                sigma = np.sqrt(self.noise_dn**2 + self.gain_dn * signal)
                frames.append(signal + sigma * rng.standard_normal(self.shape))
        return np.stack(frames)

    def frames(
        self, pattern: FringePattern, rng: np.random.Generator, steps: Callable[[FringeSet], np.ndarray] | None = None
    ) -> np.ndarray:
        """Return noisy frames as a camera of 8 bit stores them."""
        return np.clip(np.rint(self.readings(pattern, rng, steps)), 0, 255).astype(np.uint8)
