"""Two results of one mirror against each other: aligned, differenced, judged."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.comparison.pipeline.compare import compare_results as compare_results
    from deflectometry.comparison.pipeline.result import Comparison as Comparison

__getattr__, __dir__, __all__ = lazy_face(__name__)
