"""A whole recording driven by a model: free runs of all vehicles, one for each block of time, for pictures."""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.free_runs import drive_all
from sugiyama_ros.filters.causal_kernel import SETTLING
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded


def run_blocks(data: Recorded, model: Model, states: Array, fold: int) -> Array:
    """Let all vehicles drive by a model through each block of time of a fold, from the recorded state at its start.

    Parameters
    ----------
    data : Recorded
        The recording.
    model : Model
        The model, which has not seen the blocks of the fold.
    states : ndarray, shape (T, N, 4 + A)
        States filtered with this model, as ``follow`` returns them.
    fold : int
        Number of the fold.

    Returns
    -------
    ndarray, shape (T, N)
        Positions [m], wrapped on a ring; NaN in other folds, while the filter settles, and for vehicles that were not
        there at the start of the block, and on tracks, where nobody says who drives before and after a stretch.
    """
    position = np.full((data.samples, data.drivers), np.nan)
    if data.trajectories is None:
        return position
    # On one road, all drivers have the same blocks, folds and segments.
    block, fold_at, segment = data.block[0], data.fold[0], data.segment[0]
    parts = np.flatnonzero(np.diff(block) | np.diff(segment)) + 1
    for first, end in zip((0, *parts.tolist()), (*parts.tolist(), len(position)), strict=True):
        k = max(first, SETTLING + 4) if first == 0 else first
        if k + 1 >= end or fold_at[first] != fold:
            continue
        position[k] = states[k, :, 0]
        position[k + 1 : end] = drive_all(data, model, states, k, end - k - 1)
    wrapped: Array = data.trajectories.road.wrap(position)
    return np.where(data.trajectories.present, wrapped, np.nan)
