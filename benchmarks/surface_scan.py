"""Slopes of a facet from a scan of its surface: what the noise of the points leaves, and what smoothing buys.

A facet of 3 m by 2 m, 4,000 points with 0.1 mm of noise in height (V-16: about 3 mrad). It is curved (focal length
100 m) and has a wave with an amplitude of 1 mrad in slope (0.71 RMS); what a patch loses of the wave is RMS, too, and
stands beside the noise. No scanner is simulated: no outliers, no noise that neighbours share, no lost points.
Run: python benchmarks/surface_scan.py
"""

import numpy as np

WIDTH_M, HEIGHT_M, POINTS, NOISE_M, SEEDS = 3.0, 2.0, 4000, 1e-4, 10
FOCAL_LENGTH_M, WAVE_RAD = 100.0, 1e-3
SIDES = (3, 5, 7, 9, 13)
PERIODS_M = (1.0, 0.5)


def heights(x_m: np.ndarray, y_m: np.ndarray, period_m: float) -> np.ndarray:
    wave = WAVE_RAD * period_m / (2 * np.pi) * np.sin(2 * np.pi * x_m / period_m)
    return (x_m**2 + y_m**2) / (4 * FOCAL_LENGTH_M) + wave


def true_slopes(x_m: np.ndarray, period_m: float) -> np.ndarray:
    return x_m / (2 * FOCAL_LENGTH_M) + WAVE_RAD * np.cos(2 * np.pi * x_m / period_m)


def patch_weights(side: int, pitch_m: float, degree: int) -> np.ndarray:
    """Weights of a patch's heights in the slope along x in its middle, of the polynomial fitted to them."""
    steps = (np.arange(side) - side // 2) * pitch_m
    y, x = (plane.ravel() for plane in np.meshgrid(steps, steps, indexing="ij"))
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    design = np.column_stack([x**i * y**j for i, j in powers])
    return np.linalg.pinv(design)[powers.index((1, 0))].reshape(side, side)


def patch_slopes(z_m: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.einsum("ijkl,kl->ij", np.lib.stride_tricks.sliding_window_view(z_m, weights.shape), weights)


def main() -> None:
    pitch = float(np.sqrt(WIDTH_M * HEIGHT_M / POINTS))
    y, x = np.meshgrid(np.arange(0, HEIGHT_M, pitch) - 1, np.arange(0, WIDTH_M, pitch) - 1.5, indexing="ij")
    noises = [np.random.default_rng(seed).normal(0, NOISE_M, x.shape) for seed in range(SEEDS)]
    two = np.array([np.diff(noise, axis=1) / pitch for noise in noises])
    print(
        f"{x.size} points, {1e3 * pitch:.1f} mm apart, noise {1e3 * NOISE_M} mm; {SEEDS} seeds; slopes along x [mrad]"
    )
    print(f"two neighbours: scatter {1e3 * two.std():.3f}, sigma {1e3 * np.sqrt(2) * NOISE_M / pitch:.3f}")
    for degree, name in ((1, "plane"), (3, "cubic")):
        for side in SIDES[degree // 3 :]:
            weights = patch_weights(side, pitch, degree)
            sigma = NOISE_M * np.sqrt((weights**2).sum())
            scatter = np.std([patch_slopes(noise, weights) for noise in noises])
            inner = slice(side // 2, -(side // 2))
            biases = [
                np.std(patch_slopes(heights(x, y, one), weights) - true_slopes(x[inner, inner], one))
                for one in PERIODS_M
            ]
            waves = ", ".join(f"{1e3 * b:.3f} of {p} m" for b, p in zip(biases, PERIODS_M, strict=True))
            print(
                f"{name:5s} over {side:2d} x {side:2d} points: scatter {1e3 * scatter:.3f}, sigma {1e3 * sigma:.3f}, "
                f"ratio {scatter / sigma:.2f}; lost of a wave: {waves}"
            )


if __name__ == "__main__":
    main()
