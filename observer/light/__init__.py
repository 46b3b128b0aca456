"""What mirror and absorber collect: intercept factor by integration and by rays, with sigma; best aim."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from observer.light.beam import beam_profile as beam_profile
    from observer.light.beam import sun_profile as sun_profile
    from observer.light.cases import Case as Case
    from observer.light.cases import intercept_at_offsets as intercept_at_offsets
    from observer.light.cases import measured_trough as measured_trough
    from observer.light.cases import optics_of as optics_of
    from observer.light.spread import beam_spread as beam_spread
    from observer.light.spread import gaussian_short_form as gaussian_short_form
    from observer.light.trace import Sunlight as Sunlight
    from observer.light.trace import trace_intercept as trace_intercept

__getattr__, __dir__, __all__ = lazy_face(__name__)
