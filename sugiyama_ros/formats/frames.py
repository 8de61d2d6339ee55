"""Trajectories from data frames: the columns of the plain CSV file, in a table of pandas or of anything like it."""

from pathlib import Path
from typing import Any

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.samples import Samples, agreed_road
from sugiyama_ros.trajectories.trajectories import DEFAULT_LENGTH_M, Trajectories

_REQUIRED = ("time_s", "vehicle", "position_m")
_WHERE = Path("data frame")


def from_frame(frame: Any, ring_m: float | None = None) -> Trajectories:
    """Read trajectories from a data frame.

    Parameters
    ----------
    frame : pandas.DataFrame
        Columns time_s [s], vehicle (whole numbers), position_m [m] and perhaps length_m [m]; one row for each sample.
    ring_m : float, optional
        Circumference [m] of the ring; an open road without it.

    Returns
    -------
    Trajectories
        Positions of all vehicles on a regular time base.

    Raises
    ------
    InputError
        For a missing column, a value that is no number, or times without a regular base.
    """
    missing = [name for name in _REQUIRED if name not in frame.columns]
    if missing:
        raise InputError(f"{_WHERE}: no column {', '.join(missing)}; it must have {', '.join(_REQUIRED)}")
    columns = [name for name in (*_REQUIRED, "length_m") if name in frame.columns]
    try:
        table = {name: np.asarray(frame[name], dtype=np.float64) for name in columns}
    except (TypeError, ValueError) as error:
        raise InputError(f"{_WHERE}: {error}; give numbers") from None
    vehicle = table["vehicle"]
    if not np.isfinite(table["time_s"]).all() or not np.array_equal(vehicle, np.floor(vehicle)):
        raise InputError(f"{_WHERE}: a time is missing, or a vehicle is not a whole number; correct the rows")
    samples = Samples(_WHERE)
    lengths: dict[int, float] = {}
    order = np.lexsort((vehicle, table["time_s"]))
    for k in order.tolist():
        number = int(vehicle[k])
        samples.add(float(table["time_s"][k]), number, float(table["position_m"][k]), f"{_WHERE}: row {k}")
        if "length_m" in table and np.isfinite(table["length_m"][k]):
            lengths.setdefault(number, float(table["length_m"][k]))
    length_m = [lengths.get(number, DEFAULT_LENGTH_M) for number in samples.vehicles]
    return samples.trajectories(length_m, agreed_road(_WHERE, None, ring_m), "")
