"""Two results of one mirror against each other: aligned, differenced, judged."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.comparison.compare import Comparison as Comparison
    from deflectometry.comparison.compare import compare_results as compare_results

__getattr__, __dir__, __all__ = lazy_face(__name__)
