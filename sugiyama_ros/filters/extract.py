"""Chains of vehicles out of trajectories, and out of tracks: one for each driver and stretch."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import population
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.chain import AROUND, CHAIN, Chain
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.trajectories.stretches import Stretch, stretches
from sugiyama_ros.trajectories.tracks import Tracks


def chain_behind(
    trajectories: DenseTracks,
    driver: int,
    vehicles: int = CHAIN,
    segment: Ints | None = None,
    *,
    with_rear: bool = True,
) -> Chain:
    """Return the chain that starts with a driver and looks ahead."""
    samples = np.arange(len(trajectories.position_m))
    column = np.where(trajectories.present[:, driver], driver, -1)
    columns = [column]
    for _ in range(vehicles - 1):
        column = np.where(column >= 0, trajectories.leader[samples, column], -1)
        # on a ring with few vehicles the chain ends before it bites its own tail
        column = np.where(np.any([column == before for before in columns], axis=0), -1, column)
        columns.append(column)
    chain = _of_columns(trajectories, np.stack(columns, axis=1), segment)
    if not with_rear:
        return chain
    around = chain.around.copy()
    around[:, :3] = track(_of_columns(trajectories, trajectories.follower[:, driver, None], segment))
    return replace(chain, around=around)


def _of_columns(trajectories: DenseTracks, columns: Ints, segment: Ints | None) -> Chain:
    """Return the chain of the vehicles in ``columns`` (T, M), -1 for none, with nobody behind."""
    samples = np.arange(len(columns))
    there = columns >= 0
    identity = trajectories.vehicle[columns]
    if segment is not None:
        identity = identity + (int(trajectories.vehicle.max()) + 1) * segment[:, None]
    return Chain(
        position_m=np.where(there, trajectories.position_m[samples[:, None], columns], np.nan),
        identity=np.where(there, identity, -1),
        length_m=np.where(there, trajectories.length_m[columns], 0.0),
        around=np.full((len(columns), AROUND), np.nan),
        period_s=trajectories.period_s,
        start_s=trajectories.start_s,
        circumference_m=trajectories.road.circumference_m,
    )


def track(alone: Chain) -> Array:
    """Return the filtered track of a single vehicle, which moves with an AR(1) acceleration.

    Returns position [m], speed [m/s] and length [m], (T, 3); naN where the vehicle is not known.
    """
    filtered = filter_chain(alone, population())
    tracked = np.column_stack([filtered.mean[:, :2], alone.length_m[:, 0]])
    tracked[~np.isfinite(filtered.innovation_var)] = np.nan
    return tracked


def motion_of(t: DenseTracks) -> tuple[Array, Array, Ints, float]:
    """Speeds, headways and leaders, each (T, N), and the period [s], without a driver model."""
    tracks = [track(chain_behind(t, i, vehicles=1)) for i in range(len(t.vehicle))]
    position, speed = (np.stack([one[:, k] for one in tracks], axis=1) for k in range(2))
    led = t.leader >= 0
    ahead = np.take_along_axis(position, np.maximum(t.leader, 0), axis=1)
    headway = np.where(led, t.road.space_headway(ahead, position), np.nan)
    return speed, headway, np.where(led, t.leader, -1), t.period_s


@dataclass(frozen=True, eq=False)
class Drive:
    """A stretch of a driver's track, ready for the filter.

    stretch: who drives, and where the chain comes from; chain: T samples of M vehicles, with the filtered vehicle
    behind; scored: (T,), samples whose likelihood counts; the filter does not read this: whoever adds up its
    likelihoods leaves out the others.
    """

    stretch: Stretch
    chain: Chain
    scored: Mask


def drives(tracks: Tracks) -> Iterator[Drive]:
    """Make the chains of all drivers."""
    for stretch in stretches(tracks):
        yield Drive(stretch, chain_of(stretch), stretch.scored)


def divided(drive: Drive, parts: int) -> Drive:
    """Return a stretch with empty samples that divide its period."""
    if parts == 1:
        return drive
    chain, there = drive.chain, parts * (len(drive.scored) - 1) + 1
    position, around = (np.full((parts * len(one), one.shape[1]), np.nan) for one in (chain.position_m, chain.around))
    position[::parts], identity = chain.position_m, np.repeat(chain.identity, parts, axis=0)
    identity[there:] = -1
    samples, times = np.arange(len(identity)), np.arange(0, len(identity), parts)
    for k, column in enumerate(chain.around.T):
        # the vehicle behind goes on evenly between two samples
        around[:there, k] = np.interp(samples[:there], times, column)
    # a line is where it is, and between two samples its times pass as time does
    around[:there, 3:] = np.repeat(chain.around[:, 3:], parts, axis=0)[:there]
    around[:there, [4, 5, 8, 9]] -= (chain.period_s / parts * (samples[:there] % parts))[:, None]
    finer = replace(
        chain,
        position_m=position,
        identity=identity,
        length_m=np.repeat(chain.length_m, parts, axis=0),
        around=around,
        period_s=chain.period_s / parts,
    )
    return Drive(drive.stretch, finer, np.repeat(drive.scored, parts))


def chain_of(stretch: Stretch) -> Chain:
    """The chain of one stretch."""
    behind = stretch.behind
    around: Array = np.full((len(behind), AROUND), np.nan)
    if (behind[:, 0] >= 0).any():
        around[:, :3] = track(
            _chain(stretch, behind[:, 1:2], behind[:, :1].astype(np.int64), np.nan_to_num(behind[:, 2:]), around)
        )
    around[:, 3:] = stretch.line
    return _chain(stretch, stretch.position_m, stretch.identity, stretch.length_m, around)


def _chain(stretch: Stretch, position_m: Array, identity: Ints, length_m: Array, around: Array) -> Chain:
    return Chain(
        position_m=position_m,
        identity=identity,
        length_m=length_m,
        around=around,
        period_s=stretch.period_s,
        start_s=stretch.start_s,
        circumference_m=stretch.ring_m,
    )
