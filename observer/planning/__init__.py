"""What a flight will be worth before it is made."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from observer.planning.keys import ObserverPlanModel as ObserverPlanModel
    from observer.planning.photo_network import Believed as Believed
    from observer.planning.photo_network import drawn_network as drawn_network
    from observer.planning.plan import planned_network as planned_network
    from observer.planning.plan import planned_passes as planned_passes
    from observer.planning.simulated_edges import EdgeNoise as EdgeNoise
    from observer.planning.simulated_edges import Scene as Scene
    from observer.planning.simulated_flight import Evaluation as Evaluation
    from observer.planning.simulated_flight import error_theta_ra as error_theta_ra
    from observer.planning.simulated_flight import simulate as simulate

__getattr__, __dir__, __all__ = lazy_face(__name__)
