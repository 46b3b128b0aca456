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

__getattr__, __dir__, __all__ = lazy_face(
    __name__,
    {
        "Believed": "observer.planning.photo_network",
        "EdgeNoise": "observer.planning.simulated_edges",
        "Evaluation": "observer.planning.simulated_flight",
        "ObserverPlanModel": "observer.planning.keys",
        "Scene": "observer.planning.simulated_edges",
        "drawn_network": "observer.planning.photo_network",
        "error_theta_ra": "observer.planning.simulated_flight",
        "planned_network": "observer.planning.plan",
        "planned_passes": "observer.planning.plan",
        "simulate": "observer.planning.simulated_flight",
    },
)
