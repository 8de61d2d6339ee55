"""Parameters of the drivers ahead, who are known from an earlier pass of a calibration on tracks."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.vehicle_classes import medians_of, rows_of_classes
from sugiyama_ros.filters.extract import Drive
from sugiyama_ros.fit.driver import Fit
from sugiyama_ros.fit.each_driver import most_seen
from sugiyama_ros.trajectories.tracks import Tracks


class DriversAhead:
    """Parameters of the drivers ahead.

    tracks: the tracks on the time base of the stretches; typical: (P,), parameters of a driver of whom nothing is
    known; known: (P,), parameters of calibrated drivers by recording and vehicle; of_class: returns the parameters (P,)
    of a class of vehicles; the typical ones if left out.
    """

    def __init__(
        self,
        tracks: Tracks,
        typical: Array,
        known: Mapping[tuple[str, str], Array] = MappingProxyType({}),
        of_class: Callable[[str], Array] | None = None,
    ) -> None:
        self._tracks, self._typical, self._known = tracks, typical, known
        self.of_class = of_class or (lambda _: typical)

    def of(self, drivers: Sequence[Sequence[Drive]], fits: Sequence[Fit], estimated: Sequence[str]) -> "DriversAhead":
        """Return the parameters of calibrated drivers, and of their classes."""
        stretches = [own[0].stretch for own in drivers]
        known = {(one.recording, one.vehicle): fit.parameters for one, fit in zip(stretches, fits, strict=True)}
        classes = medians_of([(one.vehicle_class, None) for one in stretches], fits, estimated)
        (everybody,) = medians_of([("", None)] * len(fits), fits, estimated)
        return DriversAhead(self._tracks, self._typical, known, rows_of_classes(classes, everybody, self._typical))

    def __call__(self, own: Sequence[Drive]) -> tuple[Array, ...]:
        """Return the parameters (M - 1, P) of the vehicles that are ahead in most samples of each stretch."""
        return tuple(np.array([self._row(most_seen(one)) for one in d.chain.identity[:, 1:].T]) for d in own)

    def _row(self, run: int) -> Array:
        if run < 0:
            return self._typical
        row, tracks = int(self._tracks.start[run]), self._tracks
        kind = "" if tracks.vehicle_class is None else tracks.vehicle_class.at(row)
        known = self._known.get((tracks.recording.at(row), tracks.vehicle.at(row)))
        return self.of_class(kind) if known is None else known
