"""The errors every package raises: what went wrong, where, and what to do."""


class MetrologyError(Exception):
    """Base of every error this software raises on purpose; the command line shows its message and exits with 2."""


class InputError(MetrologyError):
    """The caller's data are impossible: a missing file, a wrong shape, a unit or key that cannot be meant."""


class EstimationError(MetrologyError):
    """The data are valid but do not determine the answer; the message gives the numbers and the remedy."""


class SweptWarning(UserWarning):
    """What a killed run had left beside results was removed, or put back."""


class ReportWarning(UserWarning):
    """A report could not be made; the results it would have shown are complete on disk."""


class NotConvergedError(EstimationError):
    """An adjustment ended where there is no minimum to the stated tolerance."""
