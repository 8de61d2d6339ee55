"""The picture in docs/junctions.md: the attention that drivers pay to a line, and what they do.

python docs/junctions_picture.py docs/junctions.png
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

from sugiyama_ros.driver.line import TIME_GAP_S, attention
from sugiyama_ros.driver.parameters import REFERENCE_HORIZON, REFERENCE_PERIOD_S, defaults
from sugiyama_ros.driver.utility import ACTIONS, scratch_for
from sugiyama_ros.effects.control import intend
from sugiyama_ros.effects.effect import Seen
from sugiyama_ros.effects.registry import ROW

mpl.use("Agg")
from matplotlib import pyplot as plt

# Gap to the line [m] and speed [m/s] of a driver.
DRIVERS = {"standing, 1 m before the line": (1.0, 0.0), "5 m/s, 10 m": (10.0, 5.0), "10 m/s, 25 m": (25.0, 10.0)}
# Time [s] for which who goes first is on the place behind the line.
TAKEN_S = 1.5


def action(gap: float, speed: float, arrive_s: float) -> float:
    """Mean action [m/s^2] of a typical driver on a free road, before a line."""
    nothing = dict.fromkeys(Seen._fields, 0.0)
    free = dict.fromkeys(("gap", "second_gap", "rear_gap", "past_gap"), np.inf)
    line = {"line_gap": gap, "arrive_s": arrive_s, "clear_s": arrive_s + TAKEN_S}
    seen = Seen(**(nothing | free | line | {"speed": speed, "past_speed": speed}))
    row = ROW.with_effects(defaults(1))[0]
    return intend(seen, row, scratch_for(ACTIONS), REFERENCE_PERIOD_S, REFERENCE_HORIZON)[0]


def main(picture: Path) -> None:
    """Draw the attention and the mean action over the time until somebody who goes first arrives."""
    figure, (paid, done) = plt.subplots(1, 2, figsize=(10, 3.6), sharex=True, layout="constrained")
    arrive_s = np.linspace(0.0, 9.0, 400)
    for (label, (gap, speed)), colour in zip(DRIVERS.items(), ("#0072b2", "#e69f00", "#009e73"), strict=True):
        paid.plot(
            arrive_s, [attention(gap, speed, t, t + TAKEN_S, TIME_GAP_S) for t in arrive_s], color=colour, label=label
        )
        done.plot(arrive_s, [action(gap, speed, t) for t in arrive_s], color=colour)
    paid.set_ylabel("attention to the line")
    done.set_ylabel("mean action [m/s²]")
    paid.legend(fontsize="small")
    figure.supxlabel("time until who goes first arrives [s]", fontsize="medium")
    figure.savefig(picture, dpi=80)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
