"""What a diagnosis hands on for pictures: the recording, driven by the model before and after the additions."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arrays import Array

if TYPE_CHECKING:
    from sugiyama_ros.diagnosis.diagnosis import Diagnosis

# Time between two samples of a picture [s], and largest number of points of one run in the document.
_EVERY_S, _MOST = 0.6, 20_000


def drives(d: "Diagnosis") -> dict[str, Any]:
    """Return free runs through all blocks of time with the model before and after the additions, thinned out.

    Parameters
    ----------
    d : Diagnosis
        The diagnosis.

    Returns
    -------
    dict
        ``time_s`` (T,), ``block`` (T,), and the positions [m] ``before`` and ``after`` (T, N), wrapped on a ring; None
        where a vehicle is not there. In each block the model starts anew from the measured state.
    """
    t = d.data.trajectories
    samples, vehicles = t.position_m.shape
    every = max(1, round(_EVERY_S / t.period_s), math.ceil(samples * vehicles / _MOST))
    return {
        "time_s": [round(t.start_s + k * t.period_s, 3) for k in range(0, samples, every)],
        "block": d.data.block[::every].tolist(),
        "before": _rows(d.before.block_position_m[::every]),
        "after": _rows(d.after.block_position_m[::every]),
    }


def _rows(position_m: Array) -> list[list[float | None]]:
    return [[round(x, 1) if np.isfinite(x) else None for x in row] for row in position_m.tolist()]
