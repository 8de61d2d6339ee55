"""The engines of the online filter: a step in one call of compiled code, or with filterpy's predict and update."""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.batch import clear, grid_for
from sugiyama_ros.driver.parameters import NAMES, UTILITY, at_period, population
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.registry import ROW, active, effect, index_of
from sugiyama_ros.filters.alarm import onsets_for
from sugiyama_ros.filters.chain import AROUND, Adaptation, adaptation_of, chain_parameters
from sugiyama_ros.filters.noise import NOISES, Learning, Noises
from sugiyama_ros.filters.online_step import (
    HEADER,
    RESULTS,
    TAKEN,
    Sizes,
    compare,
    finish,
    go_on,
    linearise_again,
    memory_for,
    online_arrays,
    step,
    teach,
    weigh,
)
from sugiyama_ros.filters.state import STATE, Scene, scene_at


@dataclass(frozen=True, eq=False)
class ChainModel:
    """Parameters, priors and scene of a chain of M vehicles with A adapted parameters; ``chain_model`` makes it.

    row: (WIDTH,) of the driver at the reference period; rows: (M, WIDTH) of all drivers at the period of the samples;
    places: (A,) of the adapted parameters in UTILITY; prior_mean, prior_var: (A,) of their logarithms; noise_shift:
    (2,) of the logarithms of NOISES from the reference period to the period of the samples; sees_rear: whether an
    effect depends on the vehicle behind.
    """

    row: Array
    rows: Array
    places: Ints
    prior_mean: Array
    prior_var: Array
    noise_shift: Array
    scene: Scene
    sees_rear: bool

    @property
    def adapted(self) -> list[int]:
        """Places of the adapted parameters in a driver's row."""
        return [UTILITY[k] for k in self.places]

    @property
    def adapted_entries(self) -> slice:
        """Entries of the state that are logarithms of adapted parameters."""
        first = STATE * len(self.rows)
        return slice(first, first + len(self.places))


def chain_model(
    row: Array, ahead: Array | None, adaptation: Adaptation, vehicles: int, period_s: float, circumference_m: float
) -> ChainModel:
    """Return the model of a chain.

    period_s: time between two samples [s]; circumference_m: length of the ring [m], 0 for an open road.
    """
    adaptation = adaptation_of(row, adaptation)
    places, prior_var = adaptation.arrays
    names = active(row)
    others = ROW.with_effects(population() if ahead is None else ahead)
    others[len(NAMES) :] = row[len(NAMES) :]
    for name in names:
        if effect(name).individual:
            others[[index_of(name, p.name) for p in effect(name).parameters]] = 0.0
    rows = at_period(chain_parameters(row, others, vehicles), period_s)
    return ChainModel(
        row=row,
        rows=rows,
        places=places,
        prior_mean=np.log(rows[0, [UTILITY[k] for k in places]]),
        prior_var=prior_var,
        noise_shift=np.log(rows[0, NOISES] / row[NOISES]),
        scene=scene_at(period_s, circumference_m, adaptation.relaxation_s),
        sees_rear=any(effect(name).sees_rear for name in names) and vehicles > 1,
    )


class Estimate(NamedTuple):
    """What is known of a driver after the update with one sample.

    position_m (wrapped on a ring), speed [m/s], acceleration [m/s^2] and their covariance (3, 3); mean_action [m/s^2];
    gap_m (infinite without a leader) and approach_rate [m/s]; innovation_m, nis and log_likelihood (no 2 pi term) of
    the sample, NaN where it is missing or nothing was predicted; innovation_var [m^2]; scored: whether it counts. Where
    noises are learnt, the log-likelihood allows for outliers (``Learning.outliers``).
    """

    position_m: float
    speed: float
    acceleration: float
    covariance: Array
    mean_action: float
    gap_m: float
    approach_rate: float
    innovation_m: float
    innovation_var: float
    nis: float
    log_likelihood: float
    scored: bool


class OnlineKalman:
    """The Kalman filter of a chain and all that learns from its steps.

    model: the chain; ``change`` sets another one; learning: how the driver's noises are learnt, None if they are not;
    memory: all that the filter knows; compiled code changes it; arrays: the arrays in it, of which some are named here
    too: x, P: mean (4 M + A,) and covariance (4 M + A, 4 M + A) of the state; next_mean: predicted mean at the next
    sample, (4 M + A,); rows: rows of all drivers with what is learnt, (M, WIDTH); change_of_style: name of the
    parameter that has jumped at the latest sample, and its factor; none if none has; places, names: (A,) places in a
    driver's row and names of what is learnt: of the noises, and then of the adapted parameters; prior_var: (A,) of
    their logarithms before the first sample.
    """

    def __init__(self, model: ChainModel, learning: Learning | None) -> None:
        self.learning = learning
        self.change_of_style: tuple[str, float] | None = None
        period, adapted = model.scene.period_s, len(model.places)
        models = 0 if learning is None else len(learning.relaxations_s)
        columns = onsets_for(period)[1] * adapted
        self._use(memory_for(Sizes(len(model.rows), adapted, models, columns, len(model.row))))
        arrays = self.arrays
        arrays.book.identity[:] = -1
        arrays.sample.when[1] = 1.0
        arrays.step.out.live[:] = np.arange(len(self.x))
        clear(arrays.step.batch.blocks)
        arrays.alarm.begin(period)
        self._put(model)
        entries = model.adapted_entries
        self.x[entries] = model.prior_mean
        self.P[entries, entries] = np.diag(model.prior_var)
        if learning is not None:
            arrays.noises.begin(learning, np.log(self.rows[0, NOISES]), period)

    def _use(self, memory: Array) -> None:
        """Use a memory with this filter's sizes."""
        self.memory = memory
        self.arrays = online_arrays(memory)
        state = self.arrays.step.state
        self.x, self.P, self.rows = state.mean, state.covariance, self.arrays.step.drivers.parameters
        self.next_mean = self.arrays.step.out.next_mean
        self._covariance = self.arrays.result[RESULTS:].reshape((3, 3))
        m = len(state.known)
        self._bytes = memory.data.cast("B")
        self._pack = struct.Struct(f"={m}d{m}q{m}d{AROUND}d2d").pack_into
        self._unpack = struct.Struct(f"={RESULTS}d").unpack_from
        self._result_at = self.arrays.result.ctypes.data - memory.ctypes.data

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy needs: its arrays lie in a memory of their own."""
        names = ("learning", "change_of_style", "model", "memory", "places", "names", "prior_var", "_scale")
        return {name: self.__dict__[name] for name in names}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._use(self.memory)

    @property
    def noises(self) -> Noises | None:
        """The driver's noises, None if they are not learnt."""
        return None if self.learning is None else self.arrays.noises

    @property
    def values(self) -> Array:
        """Parameters (A,) that are learnt, at the reference period."""
        return np.asarray(self.rows[0, self.places] * self._scale)

    @property
    def learnt(self) -> tuple[Array, Array]:
        """Logarithms (A,) of what is learnt, at the reference period, and their covariance (A, A)."""
        entries = self.model.adapted_entries
        mean, covariance = self.x[entries].copy(), self.P[entries, entries].copy()
        if self.noises is None:
            return mean, covariance
        first, both = len(NOISES), np.zeros((len(NOISES) + len(mean), len(NOISES) + len(mean)))
        both[:first, :first], both[first:, first:] = self.noises.covariance, covariance
        return np.concatenate([self.noises.mean - self.model.noise_shift, mean]), both

    def change(self, model: ChainModel) -> None:
        """Go on with another model of the same chain; the driver's own parameters stay as they are known."""
        learnt = self.rows[0, : len(NAMES)].copy()
        self._put(model)
        self.rows[0, : len(NAMES)] = learnt
        linearise_again(self.memory)

    def speed_of(self, m: int, vehicle: int) -> float:
        """Return the speed [m/s] of vehicle number m of the chain; 0 if it is another vehicle, or not known."""
        return float(self.x[STATE * m + 1]) if self.arrays.book.identity[m] == vehicle else 0.0

    def saved(self) -> Any:
        """Return all that the filter knows now, for ``restore``."""
        return self.memory.copy(), self.change_of_style, self.model

    def restore(self, saved: Any) -> None:
        """Go back to what ``saved`` has returned."""
        self.memory[:], self.change_of_style, self.model = saved

    def _put(self, model: ChainModel) -> None:
        """Put a model's numbers into the arrays."""
        self.model = model
        drivers, batch = self.arrays.step.drivers, self.arrays.step.batch
        drivers.parameters[:], drivers.adapted[:] = model.rows, model.places
        drivers.prior_mean[:], drivers.prior_var[:] = model.prior_mean, model.prior_var
        noises = NOISES if self.learning is not None else []
        noise_std = self.learning.prior_std if self.learning is not None else ()
        self.places = np.array([*noises, *model.adapted], np.int64)
        self.names = tuple(NAMES[k] for k in self.places)
        self.prior_var = np.concatenate([np.square(noise_std), model.prior_var])
        self._scale = model.row[self.places] / np.concatenate([model.rows[0, noises], model.row[model.adapted]])
        grid = grid_for(ACTIONS, model.scene.period_s)
        self.arrays.settings[:7] = *model.scene, grid.braking
        batch.grid.actions[:], batch.grid.backward[:] = grid.actions, grid.backward

    def step(
        self,
        position_m: Sequence[float],
        identity: Sequence[int],
        length_m: Sequence[float],
        around: Sequence[float],
        time_s: float,
        periods: float = 1.0,
    ) -> Estimate:
        """Go on by some periods and take in a sample.

        position_m, identity, length_m: of the vehicles, (M,), as for ``OnlineFilter.step``; around: (11,) what else the
        driver sees, as of ``Chain.around``; ``NOTHING_AROUND`` where nothing is known; time_s: time of the recording
        [s]; periods: time since the sample before, in periods of the model: one step of ``steps_between``.
        """
        self._pack(self._bytes, 8 * HEADER, *position_m, *identity, *length_m, *around, time_s, periods)
        self._step()
        *told, scored, changed, jump = self._unpack(self._bytes, self._result_at)
        self.change_of_style = None if changed < 0.0 else (NAMES[self.model.adapted[int(changed)]], math.exp(jump))
        return Estimate._make((*told[:3], self._covariance.copy(), *told[3:], scored > 0.0))

    def _step(self) -> None:
        """Carry out the step in the memory."""
        step(self.memory)


class FilterpyKalman(OnlineKalman):
    """An `OnlineKalman` whose state is predicted and updated by filterpy: slow, and meant to be read."""

    def _step(self) -> None:
        """Carry out the step in the memory, as ``online_step.step``."""
        if self.arrays.book.settled[0] > 0:
            go_on(self.memory)
            self._predict()
        compare(self.memory)
        for m in np.flatnonzero(self.arrays.book.part == TAKEN).tolist():
            weigh(self.memory, m)
            self._update(m)
            teach(self.memory, m)
        finish(self.memory)

    def _predict(self) -> None:
        """Take the next mean, which is no F x, and F P F' + Q."""
        from filterpy.kalman import predict  # takes long to import

        out = self.arrays.step.out
        _, self.P[:] = predict(self.x, self.P, out.jacobian, out.noise)
        self.x[:] = self.next_mean

    def _update(self, m: int) -> None:
        """Take in the position of vehicle m. With outliers the update is a mixture of two, and shrinks P otherwise."""
        from filterpy.kalman import update

        y, slope, weight, shrink, _ = self.arrays.scratch.weighed.tolist()
        gain, x = self.arrays.scratch.gain, STATE * m
        measures = np.zeros((1, len(self.x)))
        measures[0, x] = slope
        noise_var = 1.0 / weight - slope * gain[x]
        self.x[:], covariance = update(self.x, self.P, measures @ self.x + y, noise_var, measures)
        self.P[:] = covariance - (shrink - weight) * np.outer(gain, gain)
