"""The picture in README.md, from a recorded run.

sugiyama simulate --spread 0.1 --seed 1 -o ring.mcap && sugiyama run ring.mcap -o run.mcap
python docs/picture.py run.mcap docs/demo.png
"""

import sys
from collections import defaultdict
from pathlib import Path

import matplotlib as mpl
import numpy as np

from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.formats.mcap_reader import Bag

mpl.use("Agg")
from matplotlib import pyplot as plt


def main(recording: Path, picture: Path) -> None:
    """Draw what the estimators said of the simulated drivers, over time."""
    states, parameters = defaultdict(list), defaultdict(list)
    with Bag(recording) as bag:
        topics = {t.name for t in bag.info().topics if t.name.endswith(("/state", "/parameters"))}
        for topic, _, _, m in bag.messages(topics):
            time_s = m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec
            if topic.endswith("/state"):
                states[m.vehicle].append((time_s, m.position_m, m.speed))
            else:
                std = np.sqrt(np.diag(m.covariance.reshape(len(m.name), len(m.name))))
                parameters[m.vehicle].append((time_s, *m.value[[V_STAR, KAPPA_V]], *std[[V_STAR, KAPPA_V]]))

    figure, (road, *panels) = plt.subplots(
        3, 1, figsize=(9, 8), sharex=True, height_ratios=(2, 1, 1), layout="constrained"
    )
    time_s, position_m, speed = np.concatenate([np.array(s) for s in states.values()]).T
    dots = road.scatter(time_s, position_m, c=speed, s=1.5, cmap="viridis", vmin=0, vmax=11, rasterized=True)
    figure.colorbar(dots, ax=road, label="estimated speed [m/s]", pad=0.01)
    road.set_ylabel("place on the ring [m]")
    colours = {7: "C0", 14: "C1", 20: "C2"}
    for panel, column, symbol in ((panels[0], 1, "desired speed v* [m/s]"), (panels[1], 2, "risk premium κ_v [s]")):
        for number, rows in sorted(parameters.items()):
            known = np.array(rows)
            t, value, std = known[:, 0], known[:, column], known[:, column + 2]
            colour = colours.get(number)
            if colour is None:
                panel.plot(t, value, color="0.75", lw=0.6, zorder=1)
                continue
            panel.fill_between(t, value - std, value + std, color=colour, alpha=0.2, lw=0)
            panel.plot(t, value, color=colour, lw=1.5, label=f"vehicle {number}")
        panel.set_ylabel(symbol)
    panels[0].legend(loc="upper right", ncols=3, fontsize="small", title="estimate ± one standard deviation")
    panels[1].set_xlabel("time [s]")
    figure.savefig(picture, dpi=80)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
