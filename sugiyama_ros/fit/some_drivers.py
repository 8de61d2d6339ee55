"""Some drivers of a recording, as tracks behind the vehicles that they have followed."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.filters.chain import CHAIN, Chain
from sugiyama_ros.fit.recording import Recorded


def some_drivers(data: Recorded, who: Sequence[int]) -> Recorded:
    """Return the part of a recording that says how some drivers drive.

    Parameters
    ----------
    data : Recorded
        The recording.
    who : sequence of int
        Numbers of the drivers.

    Returns
    -------
    Recorded
        These drivers, in this order. The vehicles ahead of them drive as measured, whoever drove them.
    """
    chosen, around = list(who), data.vicinity
    chains = tuple(data.chains[i] for i in chosen)
    # the last entry stands for somebody who is no driver here
    number = np.full(data.drivers + 1, -1)
    number[chosen] = np.arange(len(chosen))
    position, length, leader = columns_of(chains)
    vicinity = replace(
        around,
        names=tuple(around.names[i] for i in chosen),
        position_m=position,
        length_m=length,
        leader=leader,
        time_s=around.time_s[:, chosen],
        is_whole_road=False,
    )
    return replace(
        data,
        vicinity=vicinity,
        chains=chains,
        ahead=number[data.ahead[chosen]],
        block=data.block[chosen],
        fold=data.fold[chosen],
        segment=data.segment[chosen],
        scored=data.scored[chosen],
        trajectories=None,
    )


def columns_of(chains: Sequence[Chain]) -> tuple[Array, Array, Ints]:
    """Return the vehicles of chains in columns, as a ``Vicinity`` of tracks has them.

    Parameters
    ----------
    chains : sequence of Chain
        Chains of N drivers, all with T samples.

    Returns
    -------
    position_m, length_m : ndarray, shape (T, V)
        Measured positions and lengths [m]: the N drivers, the vehicles ahead of each, and those ahead of these.
    leader : ndarray of int, shape (T, V)
        Column of the vehicle ahead, or -1.
    """
    count, samples = len(chains), len(chains[0].position_m)
    columns = CHAIN * count
    position, length = np.full((samples, columns), np.nan), np.zeros((samples, columns))
    leader = np.full((samples, columns), -1)
    for i, chain in enumerate(chains):
        for m in range(chain.position_m.shape[1]):
            position[:, i + m * count], length[:, i + m * count] = chain.position_m[:, m], chain.length_m[:, m]
            if m > 0:
                leader[:, i + (m - 1) * count] = np.where(chain.identity[:, m] >= 0, i + m * count, -1)
    return position, length, leader
