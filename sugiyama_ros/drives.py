"""Chains for the filter out of tracks: one for each driver and stretch."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.filters.chain import Chain
from sugiyama_ros.filters.extract import track
from sugiyama_ros.trajectories.stretches import Stretch, stretches
from sugiyama_ros.trajectories.tracks import Tracks


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
    position, rear = (np.full((parts * len(one), one.shape[1]), np.nan) for one in (chain.position_m, chain.rear))
    position[::parts], identity = chain.position_m, np.repeat(chain.identity, parts, axis=0)
    identity[there:] = -1
    samples, times = np.arange(len(identity)), np.arange(0, len(identity), parts)
    for k, column in enumerate(chain.rear.T):
        # the vehicle behind goes on evenly between two samples
        rear[:there, k] = np.interp(samples[:there], times, column)
    finer = replace(
        chain,
        position_m=position,
        identity=identity,
        length_m=np.repeat(chain.length_m, parts, axis=0),
        rear=rear,
        period_s=chain.period_s / parts,
    )
    return Drive(drive.stretch, finer, np.repeat(drive.scored, parts))


def chain_of(stretch: Stretch) -> Chain:
    """The chain of one stretch."""
    behind = stretch.behind
    rear: Array = np.full((len(behind), 3), np.nan)
    if (behind[:, 0] >= 0).any():
        rear = track(
            _chain(stretch, behind[:, 1:2], behind[:, :1].astype(np.int64), np.nan_to_num(behind[:, 2:]), rear)
        )
    return _chain(stretch, stretch.position_m, stretch.identity, stretch.length_m, rear)


def _chain(stretch: Stretch, position_m: Array, identity: Ints, length_m: Array, rear: Array) -> Chain:
    return Chain(
        position_m=position_m,
        identity=identity,
        length_m=length_m,
        rear=rear,
        period_s=stretch.period_s,
        start_s=stretch.start_s,
        circumference_m=stretch.ring_m,
    )
