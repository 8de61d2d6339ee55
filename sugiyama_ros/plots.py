"""Drawings that several results share, for figures of matplotlib."""

from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

#: Colours that people with any colour vision tell apart (Okabe and Ito).
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#e69f00", "#009e73", "#7f7f7f"


def space_time(figure: "Figure | SubFigure", time_s: Array, position_m: Array, speed: Array) -> None:
    """Draw trajectories in space and time, coloured by speed.

    time_s: (T,), times [s]; position_m, speed: (T, N), positions [m], wrapped on a ring, and speeds [m/s]; naN where
    unknown.
    """
    axes = figure.subplots()
    time = np.broadcast_to(time_s[:, None], position_m.shape)
    seen = (time.ravel(), position_m.ravel())
    dots = axes.scatter(*seen, c=speed.ravel(), s=1.5, cmap="cividis", linewidths=0, rasterized=True)
    figure.colorbar(dots, ax=axes, label="speed [m/s]")
    axes.set(xlabel="time [s]", ylabel="position [m]")


def bars(axes: Any, names: list[str], values: list[float], errors: list[float], label: str) -> None:
    """Draw horizontal bars with error bars, the first bar on top."""
    axes.barh(names[::-1], values[::-1], xerr=errors[::-1], color=BLUE, ecolor=GREY)
    axes.set(xlabel=label)
