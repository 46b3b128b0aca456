"""Fixed patterns: a printed or projected field of dots seen in a mirror, one photo for each measurement.

The photo's dots are found and numbered (`found_dots`), their place in the pattern is decided (`origin`), and as a
`DotSource` they pass through the same stages as fringes.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.dots.dot_source import DotSource as DotSource
    from deflectometry.dots.found_dots import FoundDots as FoundDots
    from deflectometry.dots.found_dots import find_dots as find_dots
    from deflectometry.dots.keys import load_dots as load_dots
    from deflectometry.dots.pipeline.measure import run as run

__getattr__, __dir__, __all__ = lazy_face(__name__)
