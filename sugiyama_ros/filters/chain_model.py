"""The drivers of a chain as the online filter models them before it has learnt anything."""

from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import NAMES, UTILITY, at_period, population
from sugiyama_ros.effects.effect import MEASUREMENT
from sugiyama_ros.effects.registry import ROW, active, effect, index_of
from sugiyama_ros.filters.chain import Adaptation, adaptation_of, chain_parameters
from sugiyama_ros.filters.noise import NOISES
from sugiyama_ros.filters.state import STATE, Scene, scene_at


@dataclass(frozen=True, eq=False)
class ChainModel:
    """Parameters, priors and scene of a chain of M vehicles with A adapted parameters; ``chain_model`` makes it.

    row: (WIDTH,) of the driver at the reference period; rows: (M, WIDTH) of all drivers at the period of the samples;
    places: (A,) of the adapted parameters in UTILITY; prior_mean, prior_var: (A,) of their logarithms; noise_shift:
    (2,) of the logarithms of NOISES from the reference period to the period of the samples; sees_rear: whether an
    effect depends on the vehicle behind; measured_otherwise: whether an effect of the measurement is on.
    """

    row: Array
    rows: Array
    places: Ints
    prior_mean: Array
    prior_var: Array
    noise_shift: Array
    scene: Scene
    sees_rear: bool
    measured_otherwise: bool

    @property
    def vehicles(self) -> int:
        """Number M of vehicles."""
        return len(self.rows)

    @property
    def adapted(self) -> list[int]:
        """Places of the adapted parameters in a driver's row."""
        return [UTILITY[k] for k in self.places]

    @property
    def adapted_entries(self) -> slice:
        """Entries of the state that are logarithms of adapted parameters."""
        return slice(STATE * self.vehicles, STATE * self.vehicles + len(self.places))


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
        measured_otherwise=any(effect(name).stage == MEASUREMENT for name in names),
    )
