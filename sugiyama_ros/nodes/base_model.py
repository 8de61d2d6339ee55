"""The base model beside the estimators: what the one-step errors would be without added effects."""

from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.driver.parameters import population
from sugiyama_ros.filters.chain import CHAIN
from sugiyama_ros.filters.online import OnlineFilter, warm_up
from sugiyama_ros.nodes.base.cdr_messages import NS, Sample
from sugiyama_ros.nodes.base.sight import sight
from sugiyama_ros.road import Road


class BaseModel:
    """One filter of the base model for each vehicle.

    road: the road, and the time between two samples.
    """

    def __init__(self, road: RoadMessage) -> None:
        warm_up()
        self._road, self._period_s = Road(float(road.circumference_m)), float(road.period_s)
        self._filters: dict[int, OnlineFilter] = {}

    def follow(self, sample: Sample) -> list[float]:
        """Follow all vehicles of a sample, and return the one-step errors [m] that count."""
        errors = []
        for vehicle in sample.place:
            if vehicle not in self._filters:
                self._filters[vehicle] = OnlineFilter(self._period_s, self._road, population())
            chain = sample.chain(vehicle, CHAIN)
            position, length, behind = sight(sample, vehicle, chain)
            try:
                found = self._filters[vehicle].step(position, chain, length, sample.stamp_ns / NS, behind)
            except ArithmeticError:  # nobody drives like this; the filter begins anew
                del self._filters[vehicle]
                continue
            if found.scored:
                errors.append(float(found.innovation_m))
        return errors
