"""The engine of the online filter that works out a step in one call of compiled code."""

import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.lanes import clear, grid_for
from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.filters.alarm import BETWEEN_FALSE_S, BLOCK_S, BLOCKS_S, ONSET_S, QUIET_S, WATCHED_S
from sugiyama_ros.filters.chain_model import ChainModel
from sugiyama_ros.filters.engine import Estimate
from sugiyama_ros.filters.noise import NOISES, Learning
from sugiyama_ros.filters.online_kernel import linearise_again, step
from sugiyama_ros.filters.online_state import (
    RESULTS,
    Noises,
    Sizes,
    layout_of,
    memory_for,
    online_arrays,
)
from sugiyama_ros.filters.state import STATE
from sugiyama_ros.road import Road


class CompiledKalman:
    """The Kalman filter of a chain and all that learns from its steps; see ``Engine``.

    model: the chain; ``change`` sets another one; road: the road that the vehicles drive on; learning: how the driver's
    noises are learnt, None if they are not; arrays: all that the filter knows; compiled code changes them; x, P,
    next_mean, rows: arrays among them, as in ``Engine``; memory, layout: where the arrays lie, as
    ``online_kernel.step`` takes it.
    """

    def __init__(self, model: ChainModel, road: Road, learning: Learning | None) -> None:
        self.road, self.learning = road, learning
        self.change_of_style: tuple[str, float] | None = None
        period, adapted = model.scene.period_s, len(model.places)
        every = max(1, round(ONSET_S / period))
        onsets = max(1, round(WATCHED_S / (every * period)))
        models = 0 if learning is None else len(learning.relaxations_s)
        self.layout = layout_of(Sizes(model.vehicles, adapted, models, onsets * adapted))
        self._use(memory_for(self.layout))
        arrays = self.arrays
        arrays.book.identity[:] = -1
        arrays.sample.when[1] = 1.0
        arrays.linearised.live[:] = np.arange(len(self.x))
        clear(arrays.lanes.blocks)
        arrays.alarm.every[0], arrays.alarm.threshold[0] = every, BETWEEN_FALSE_S / (every * period)
        block = max(1, round(BLOCK_S / period))
        arrays.alarm.colour[:3] = block, math.exp(-block * period / BLOCKS_S), QUIET_S / period
        self._put(model)
        entries = model.adapted_entries
        self.x[entries] = model.prior_mean
        self.P[entries, entries] = np.diag(model.prior_var)
        if learning is not None:
            _prepare(arrays.noises, learning, np.log(self.rows[0, NOISES]), period)

    def _use(self, memory: Array) -> None:
        """Use a memory with this filter's layout."""
        self.memory = memory
        self.arrays = online_arrays(memory, self.layout)
        state = self.arrays.state
        self.x, self.P, self.rows = state.mean, state.covariance, self.arrays.drivers.parameters
        self.next_mean = self.arrays.linearised.next_mean
        self._covariance = self.arrays.result[RESULTS:].reshape((3, 3))
        vehicles = len(state.known)
        self._bytes = memory.data.cast("B")
        self._pack = struct.Struct(f"={vehicles}d{vehicles}q{vehicles}d3d2d").pack_into
        self._unpack = struct.Struct(f"={RESULTS}d").unpack_from
        self._result_at = 8 * (3 * vehicles + 5)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs: its arrays lie in a memory of their own."""
        return {
            "road": self.road,
            "learning": self.learning,
            "change_of_style": self.change_of_style,
            "model": self.model,
            "layout": self.layout,
            "memory": self.memory,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._use(self.memory)

    @property
    def noises(self) -> Noises | None:
        """The driver's noises, None if they are not learnt."""
        return None if self.learning is None else self.arrays.noises

    def change(self, model: ChainModel) -> None:
        """Go on with another model of the same chain; the driver's own parameters stay as they are known."""
        learnt = self.rows[0, : len(NAMES)].copy()
        self._put(model)
        self.rows[0, : len(NAMES)] = learnt
        linearise_again(self.memory, self.layout)

    def speed_of(self, m: int, vehicle: int) -> float:
        """Return the speed [m/s] of vehicle number m of the chain; 0 if it is another vehicle, or not known."""
        return float(self.x[STATE * m + 1]) if self.arrays.book.identity[m] == vehicle else 0.0

    def saved(self) -> tuple[Array, tuple[str, float] | None]:
        """Return all that the filter knows now, for ``restore``."""
        return self.memory.copy(), self.change_of_style

    def restore(self, saved: tuple[Array, tuple[str, float] | None]) -> None:
        """Go back to what ``saved`` has returned, with the same model."""
        self.memory[:], self.change_of_style = saved

    def _put(self, model: ChainModel) -> None:
        """Put a model's numbers into the arrays."""
        self.model = model
        drivers = self.arrays.drivers
        drivers.parameters[:], drivers.adapted[:] = model.rows, model.places
        drivers.prior_mean[:], drivers.prior_var[:] = model.prior_mean, model.prior_var
        self.arrays.scene[:] = model.scene
        grid = grid_for(ACTIONS, model.scene.period_s)
        self.arrays.lanes.grid.actions[:] = grid.actions
        self.arrays.lanes.grid.backward[:] = grid.backward
        self.arrays.braking[0] = grid.braking

    def step(
        self,
        position_m: Sequence[float],
        identity: Sequence[int],
        length_m: Sequence[float],
        rear: tuple[float, float, float],
        time_s: float,
        periods: float = 1.0,
    ) -> Estimate:
        """Go on by some periods and take in a sample; see ``Engine.step``."""
        self._pack(self._bytes, 0, *position_m, *identity, *length_m, *rear, time_s, periods)
        step(self.memory, self.layout)
        (
            position,
            speed,
            acceleration,
            mean_action,
            gap,
            approach_rate,
            innovation,
            variance,
            nis,
            density,
            scored,
            changed,
            jump,
        ) = self._unpack(self._bytes, self._result_at)
        self.change_of_style = None if changed < 0.0 else (NAMES[self.model.adapted[int(changed)]], math.exp(jump))
        return Estimate(
            position,
            speed,
            acceleration,
            self._covariance.copy(),
            mean_action,
            gap,
            approach_rate,
            innovation,
            variance,
            nis,
            density,
            scored > 0.0,
        )


def _prepare(noises: Noises, learning: Learning, prior_mean: Array, period_s: float) -> None:
    """Put in how noises are learnt, and their prior; prior_mean: (2,) of the logarithms."""
    noises.kept[:] = np.exp(-period_s / np.array(learning.relaxations_s))
    noises.prior_mean[:], noises.prior_var[:] = prior_mean, np.square(learning.prior_std)
    noises.stay[0] = math.exp(-period_s / learning.dwell_s)
    noises.outliers[:] = learning.outliers
    noises.weight[:] = 1.0 / len(noises.weight)
    noises.recall(prior_mean, np.diag(noises.prior_var))
