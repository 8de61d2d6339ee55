"""A whole recording driven by a model: free runs of all vehicles, one for each block of time, for pictures."""

from collections.abc import Sequence

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.free_runs import drive_all
from sugiyama_ros.filters.causal_kernel import SETTLING
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded


def run_blocks(data: Recorded, models: Sequence[Model], states: Sequence[Array]) -> Array:
    """Let all vehicles drive by the model through each block of time, from the recorded state at its first sample.

    Parameters
    ----------
    data : Recorded
        The recording.
    models : sequence of Model
        For every fold, the model fitted without the fold. No block is driven by a model that has seen the block.
    states : sequence of ndarray, shape (T, N, 4)
        Filtered states of each of the models, as ``filtered_states`` returns them.

    Returns
    -------
    ndarray, shape (T, N)
        Positions [m], wrapped on a ring; NaN while the filter settles, and for vehicles that were not there at the
        start of the block, and on tracks, where nobody says who drives before and after a stretch.
    """
    around = data.vicinity
    position = np.full((data.samples, data.drivers), np.nan)
    if not around.is_whole_road:
        return position
    # On one road, all drivers have the same blocks, folds and segments.
    block, fold_at, segment = data.block[0], data.fold[0], data.segment[0]
    parts = np.flatnonzero(np.diff(block) | np.diff(segment)) + 1
    for first, end in zip((0, *parts.tolist()), (*parts.tolist(), len(position)), strict=True):
        k = max(first, SETTLING + 4) if first == 0 else first
        if k + 1 >= end:
            continue
        fold = int(fold_at[first])
        state = states[fold]
        position[k] = state[k, :, 0]
        position[k + 1 : end] = drive_all(data, models[fold], state, k, end - k - 1)
    wrapped: Array = around.road.wrap(position)
    return np.where(np.isfinite(around.position_m), wrapped, np.nan)
