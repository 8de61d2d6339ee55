"""Calibration of many drivers, each driver alone.

Drivers do not depend on each other, so any executor can run the searches: threads, processes or a Dask cluster.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import SIGMA_A, index
from sugiyama_ros.filters import paper
from sugiyama_ros.filters.chain import CHAIN
from sugiyama_ros.fit.bounds import fastest, lower_bounds, upper_bounds
from sugiyama_ros.fit.driver import PLAIN, START_SIGMA_A, Fit, Formulation, Job, SearchOptions, carry_out
from sugiyama_ros.fit.driver_score import DriverChains
from sugiyama_ros.fit.sampling import measured, with_short_periods
from sugiyama_ros.fit.smooth_positions import ESTIMATED, evenness
from sugiyama_ros.trajectories.trajectories import Trajectories
from sugiyama_ros.workers import in_turn


def calibrate(
    trajectories: Trajectories,
    formulation: Formulation = "causal",
    estimated: Sequence[str] = ESTIMATED,
    options: SearchOptions = PLAIN,
    *,
    starts: Mapping[int, Array] | None = None,
    skip: Collection[int] = (),
    work: Executor | None = None,
) -> Iterator[Fit]:
    """Fit every driver alone.

    starts: (P,), parameters by vehicle, for the start and for the drivers ahead; the default start is the paper's mean
    with a larger acceleration noise. Raises InputError.
    """
    yield from each_of(JobMaker(trajectories, formulation, estimated, starts or {}), options, skip=skip, work=work)


def each_of(
    maker: "JobMaker", options: SearchOptions, *, skip: Collection[int] = (), work: Executor | None = None
) -> Iterator[Fit]:
    """Carry out the searches that ``maker`` makes, one for each driver; the other arguments as for ``calibrate``."""
    skipped = set(skip)
    left = (i for i, v in enumerate(maker.vehicles.tolist()) if v not in skipped)
    yield from in_turn(carry_out, left, work, partial(_Jobs, maker, options))


class JobMaker:
    """Makes the plain searches for the parameters of the drivers of a recording.

    Arguments as for ``calibrate``; known: parameters (P,) by vehicle, as ``starts`` there.
    """

    def __init__(
        self,
        trajectories: Trajectories,
        formulation: Formulation,
        estimated: Sequence[str],
        known: Mapping[int, Array],
    ) -> None:
        is_causal = formulation == "causal"
        self._trajectories = with_short_periods(trajectories) if is_causal else trajectories
        self._formulation, self._known = formulation, known
        self._places = np.array([index(name) for name in estimated])
        seen = measured(trajectories)
        even, speed = evenness(seen), fastest(seen)
        self._bounds, self._typical = (lower_bounds(even), upper_bounds(speed)), even.typical(speed)

    @property
    def vehicles(self) -> Ints:
        """Numbers of the drivers' vehicles, shape (N,)."""
        return self._trajectories.vehicle

    def knowing(self, known: Mapping[int, Array]) -> "JobMaker":
        """Return a maker of the same searches from other parameters (P,) by vehicle."""
        one = copy(self)
        one._known = known
        return one

    def only(self, drivers: Sequence[int]) -> "JobMaker":
        """Return a maker of the searches for the drivers in some columns, which knows no more than they need.

        Its first columns are these drivers.
        """
        part = self._trajectories.around(drivers, CHAIN - 1)
        one = self.knowing({v: self._known[v] for v in part.vehicle.tolist() if v in self._known})
        one._trajectories = part
        return one

    def __call__(self, driver: int) -> Job:
        """Return the search for the driver in column ``driver``."""
        trajectories, known = self._trajectories, self._known
        begin = self._typical.copy()
        begin[SIGMA_A] = START_SIGMA_A
        vehicle = int(trajectories.vehicle[driver])
        one = Job(vehicle, known.get(vehicle, begin), self._places, *self._bounds)
        if self._formulation == "paper":
            return replace(one, perceived=paper.perceive(trajectories, driver))
        from sugiyama_ros.filters.extract import chain_behind  # here, because the paper's formulation starts without it

        chain = chain_behind(trajectories, driver, with_rear=False)
        ahead = [known.get(most_seen(chain.identity[:, m]), self._typical) for m in range(1, CHAIN)]
        return replace(one, followed=DriverChains((chain,), (np.array(ahead),)))


class _Jobs:
    """The searches for some drivers, made one after the other where they are carried out.

    Processes and clusters get the part of the recording that these drivers see.

    maker: makes a plain search; options: options of the searches; drivers: columns of the drivers.
    """

    def __init__(self, maker: JobMaker, options: SearchOptions, drivers: Sequence[int]) -> None:
        self._maker, self._options, self._drivers = maker, options, drivers

    def __iter__(self) -> Iterator[Job]:
        return (replace(self._maker(driver), options=self._options) for driver in self._drivers)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Jobs, (self._maker.only(self._drivers), self._options, range(len(self._drivers)))


def most_seen(identity: Ints) -> int:
    """Return the number of the vehicle that is present in most samples, (T,), or -1."""
    values, counts = np.unique(identity[identity >= 0], return_counts=True)
    return int(values[np.argmax(counts)]) if len(values) else -1
