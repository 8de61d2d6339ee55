"""The picture in docs/case1.md, from the measured experiment's diagnosis.

sugiyama diagnose case1.data --ring 230 --add auto --json > case1.json
python docs/case1_picture.py case1.json docs/case1.png
"""

import json
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt

FIGURES = {
    "free_run_10s_m": "coupled free run, 10 s [m]",
    "single_car_10s_m": "single car, 10 s [m]",
    "loglik_per_sample": "log-likelihood per sample [nats]",
}
MODELS = {"before": "base", "after": "with additions", "fvdm": "FVDM", "idm": "IDM", "gipps": "Gipps"}
COVARIATES = {"speed": "speed [m/s]", "gap": "gap [m]", "approach_rate": "approach rate [m/s]"}


def main(document: Path, picture: Path) -> None:
    """Draw held-out errors of all models, and where the base model and the final one are biased."""
    found = json.loads(document.read_text())
    figure, axes = plt.subplots(2, 3, figsize=(11, 6.5), layout="constrained")
    for axis, (name, label) in zip(axes[0], FIGURES.items(), strict=True):
        values = [found["errors"][model][name] for model in MODELS]
        bars = axis.bar(list(MODELS.values()), values, color=["#888888", "#0072b2", "#e69f00", "#e69f00", "#e69f00"])
        axis.bar_label(bars, fmt="%.3g")
        axis.set_ylabel(label)
        axis.tick_params(axis="x", rotation=30)
        axis.margins(y=0.15)
    for axis, (name, label) in zip(axes[1], COVARIATES.items(), strict=True):
        for when, colour, marker in (("before", "#888888", "o"), ("after", "#0072b2", "s")):
            bins = [b for b in found["where"][when]["bins"] if b["covariate"] == name]
            middle = [0.5 * (b["low"] + b["high"]) for b in bins]
            error = [2.0 / np.sqrt(b["samples"]) for b in bins]
            axis.errorbar(middle, [b["bias"] for b in bins], error, color=colour, marker=marker, label=MODELS[when])
        axis.axhline(0.0, color="black", linewidth=0.8)
        axis.set_xlabel(label)
    axes[1][0].set_ylabel("mean innovation [predicted std]")
    axes[1][0].legend()
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
