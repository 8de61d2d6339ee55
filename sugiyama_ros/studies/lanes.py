"""Are the drivers of cars and of trucks on two lanes found again, and are the stated errors right?"""

from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.calibration.on_tracks import calibrate_tracks
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, defaults, index
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.simulation.lanes import Lane, simulate_lanes
from sugiyama_ros.studies.rings import LENGTH_M
from sugiyama_ros.studies.study import Answer, Asked, Row, Study
from sugiyama_ros.trajectories.tracks import Tracks

#: Duration [s] of a simulated run, and vehicles on a lane.
DURATION_S, VEHICLES = 120.0, 12
_CAR, _TRUCK = "car", "truck"
_LANES, _TRUCK_EVERY, _TRUCK_M = 2, 4, 12.0
# Desired speed [m/s] and risk premium [s] of a truck.
_TRUCK_V_STAR, _TRUCK_KAPPA_V = 9.0, 0.3
# A normal error is within this many standard errors in 95 of 100 cases.
_SURE = 1.96


def _drivers_of(vehicle_class: str) -> Array:
    """Return the parameters (P,) that all drivers of a class have."""
    row: Array = defaults(1)[0]
    if vehicle_class == _TRUCK:
        row[[V_STAR, KAPPA_V]] = _TRUCK_V_STAR, _TRUCK_KAPPA_V
    return row


def two_lanes(rng: np.random.Generator) -> Tracks:
    """Simulate two lanes with trucks, which start out of a jam."""
    lanes = []
    for first in range(_LANES):
        kinds = [_TRUCK if (k + first) % _TRUCK_EVERY == 0 else _CAR for k in range(VEHICLES)]
        length = np.array([_TRUCK_M if kind == _TRUCK else LENGTH_M for kind in kinds])
        lanes.append(Lane(np.stack([_drivers_of(kind) for kind in kinds]), length, kinds))
    return simulate_lanes(lanes, DURATION_S, rng)


def _answer(asked: Asked) -> Answer:
    """Simulate two lanes, and fit all drivers who follow somebody.

    The table has, for each class, the truth, the median and the bias of the fits, and how often 95 % intervals contain
    the truth: those from standard errors, and those from the profile likelihood. Only fits count in which the parameter
    is identified.
    """
    found: list[dict[str, Any]] = []
    for k in range(asked.runs):
        tracks = two_lanes(np.random.default_rng(asked.seed + k))
        found += calibrate_tracks(tracks, Settings(profiled=True), asked.work).records()
    rows: list[Row] = []
    held: dict[tuple[str, str], Array] = {}
    for kind in (_CAR, _TRUCK):
        own = [record for record in found if record["class"] == kind]
        for name in ESTIMATED:
            known = [record for record in own if record[f"{name}_identified"]]
            columns = (name, f"{name}_std", f"{name}_low", f"{name}_high")
            value, std, low, high = (np.array([record[column] for record in known]) for column in columns)
            truth = float(_drivers_of(kind)[index(name)])
            held[kind, name] = value
            rows.append(
                {
                    "class": kind,
                    "parameter": name,
                    "truth": truth,
                    "median": float(np.median(value)) if len(value) else np.nan,
                    "bias": float(value.mean() - truth) if len(value) else np.nan,
                    "bias error": float(value.std(ddof=1) / np.sqrt(len(value))) if len(value) > 1 else np.nan,
                    "in 95 % error": float(np.mean(np.abs(value - truth) < _SURE * std)) if len(value) else np.nan,
                    "in 95 % profile": float(np.mean((low < truth) & (truth < high))) if len(value) else np.nan,
                    "identified": len(known),
                    "fits": len(own),
                }
            )

    def draw(figure: Any) -> None:
        for axes, name in zip(figure.subplots(1, len(ESTIMATED)), ESTIMATED, strict=True):
            for kind, colour in ((_CAR, "C0"), (_TRUCK, "C1")):
                axes.hist(held[kind, name], bins=20, alpha=0.6, label=kind, color=colour)
                axes.axvline(_drivers_of(kind)[index(name)], color=colour)
            axes.set(xlabel=name)
        axes.legend()

    return Answer(tuple(rows), draw)


STUDY = Study(
    name="lanes",
    question="Are the drivers of cars and trucks on two lanes found again?",
    paper="The paper has a single lane; other roads are left to later work (outlook).",
    answer=_answer,
    takes=("runs", "seed"),
)
