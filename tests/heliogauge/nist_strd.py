"""The NIST StRD nonlinear regression problems: models by hand, data and certified values from NIST's files."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

ComplexArray = npt.NDArray[np.complex128]
FloatArray = npt.NDArray[np.float64]
Model = Callable[[ComplexArray, FloatArray], ComplexArray]


def _gauss(b: ComplexArray, x: FloatArray) -> ComplexArray:
    first = b[0] * np.exp(-b[1] * x)
    return first + b[2] * np.exp(-((x - b[3]) ** 2) / b[4] ** 2) + b[5] * np.exp(-((x - b[6]) ** 2) / b[7] ** 2)


def _lanczos(b: ComplexArray, x: FloatArray) -> ComplexArray:
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def _enso(b: ComplexArray, x: FloatArray) -> ComplexArray:
    turn = 2 * np.pi * x
    year = b[1] * np.cos(turn / 12) + b[2] * np.sin(turn / 12)
    second = b[4] * np.cos(turn / b[3]) + b[5] * np.sin(turn / b[3])
    return b[0] + year + second + b[7] * np.cos(turn / b[6]) + b[8] * np.sin(turn / b[6])


def _cubic_over_cubic(b: ComplexArray, x: FloatArray) -> ComplexArray:
    return (b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3)


MODELS: dict[str, Model] = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Chwirut1": lambda b, x: np.exp(-b[0] * x) / (b[1] + b[2] * x),
    "Chwirut2": lambda b, x: np.exp(-b[0] * x) / (b[1] + b[2] * x),
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": _enso,
    "Eckerle4": lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": _gauss,
    "Gauss2": _gauss,
    "Gauss3": _gauss,
    "Hahn1": _cubic_over_cubic,
    "Kirby2": lambda b, x: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Lanczos1": _lanczos,
    "Lanczos2": _lanczos,
    "Lanczos3": _lanczos,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "MGH17": lambda b, x: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]),
    "Misra1a": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda b, x: b[0] - b[1] * x[0] * np.exp(-b[2] * x[1]),
    "Rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "Thurber": _cubic_over_cubic,
}


@dataclass(frozen=True, slots=True, eq=False)
class StrdProblem:
    """One problem with its certified answer."""

    name: str
    start_1: FloatArray
    start_2: FloatArray
    certified: FloatArray
    certified_sigma: FloatArray
    certified_squares: float
    observed: FloatArray
    predictor: FloatArray

    def evaluate(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Predicted minus observed and its derivatives, by complex steps (exact to rounding)."""
        model = MODELS[self.name]
        steps = parameters.astype(np.complex128)[:, None] + 1e-30j * np.eye(parameters.size)
        with np.errstate(all="ignore"):
            jacobian = np.stack([model(b, self.predictor).imag / 1e-30 for b in steps.T], axis=1)
            residuals = model(parameters.astype(np.complex128), self.predictor).real - self.observed
        return residuals, jacobian


def read_problem(path: Path) -> StrdProblem:
    """Read one of NIST's files."""
    lines = path.read_text().splitlines()
    rows = [re.match(r"\s*b\d+\s*=\s*(.*)", line) for line in lines]
    table = np.array(
        [[float(word) for word in row.group(1).split()] for row in rows if row and "*" not in row.group(1)]
    )
    squares = next(float(line.split(":")[1]) for line in lines if line.startswith("Residual Sum of Squares"))
    first = next(i for i, line in enumerate(lines) if line.startswith("Data:") and i > 50) + 1
    data = np.array([[float(word) for word in line.split()] for line in lines[first:] if line.strip()])
    observed, predictor = data[:, 0], data[:, 1] if data.shape[1] == 2 else data[:, 1:].T
    if path.stem == "Nelson":
        observed = np.log(observed)
    if path.stem == "Roszman1" and table[0, 2] > 1:
        # Some copies print 1.20196866396E-0 for 2.0196866396E-01; only the latter has the certified sum of squares.
        table[0, 2] = 2.0196866396e-01
    return StrdProblem(path.stem, *table.T[:4], certified_squares=squares, observed=observed, predictor=predictor)


def certified_digits(values: FloatArray, certified: FloatArray) -> float:
    """Smallest number of certified digits (log relative error), at most 11 as NIST prints 11."""
    error = np.abs(values - certified) / np.abs(certified)
    return float(np.minimum(-np.log10(np.maximum(error, 1e-11)), 11).min())
