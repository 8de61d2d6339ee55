"""Documents of diagnoses that are made by hand: small, and whole as far as pages and words read them."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

COLUMNS = ("one_step", "1s", "2s", "5s", "10s", "road_1s", "road_2s", "road_5s", "road_10s", "all")
BINS = [
    {"covariate": "regime", "label": name, "low": 0.0, "high": 1.0, "samples": 90, "bias": bias, "flagged": bias < -0.1}
    for name, bias in (("standing", 0.01), ("braking", -0.2))
]
WHERE = {
    "bins": BINS,
    "flagged": [b for b in BINS if b["flagged"]],
    "maps": [
        {
            "first": first,
            "second": second,
            "first_edges": [0.0, 20.0, 80.0],
            "second_edges": [0.0, 20.0, 40.0],
            "bias": [[0.1, None], [-0.4, 0.0]],
            "flagged": [[False, False], [True, False]],
        }
        for first, second in (("speed", "gap"), ("place", "time"))
    ],
}
ABOUT: dict[str, Any] = {
    "slow_patch": {
        "kind": "effect",
        "title": "slower stretch of road",
        "summary": "a lower desired speed on part of the road",
        "term": "v* -> v* (1 - reduction bump(x - centre, width))",
        "parameters": {
            "reduction": {"unit": "", "meaning": "share taken off v*", "axis": ""},
            "centre": {"unit": "m", "meaning": "middle", "axis": "place"},
            "width": {"unit": "m", "meaning": "length", "axis": ""},
        },
    },
    "drag": {
        "kind": "effect",
        "title": "drag",
        "summary": "resistance",
        "term": "- c0 - c2 v|v|",
        "parameters": {
            "c0": {"unit": "m/s^2", "meaning": "constant resistance; section 5", "axis": ""},
            "c2": {"unit": "1/m", "meaning": "resistance that grows with the speed squared", "axis": ""},
        },
    },
    "response_constants": {
        "kind": "constants",
        "title": "softer or harder response",
        "summary": "gap scales are fitted",
        "parameters": {"kappa_c": {"unit": "m", "meaning": "gap scale at standstill; section 5", "axis": ""}},
    },
    "discovered_force": {
        "kind": "effect",
        "title": "force without a name",
        "summary": "a curve over one covariate",
        "term": "+ force(covariate)",
        "parameters": {},
    },
    "road_grade": {"kind": "effect", "title": "hill", "summary": "gravity", "parameters": {}},
    "external_push": {"kind": "effect", "title": "push from outside", "summary": "", "parameters": {}},
    "gipps": {"kind": "law", "title": "Gipps' law", "summary": "", "parameters": {}},
}


def gains(nats: float = 50.0, se: float = 9.0, **changed: tuple[float, float]) -> dict[str, dict[str, float]]:
    """Gains by column, all of them alike but those that are given."""
    return {
        name: dict(zip(("nats", "se"), changed.get(name, changed.get(f"at_{name}", (nats, se))), strict=True))
        for name in COLUMNS
    }


def addition(name: str = "slow_patch", kind: str = "effect", **changed: Any) -> dict[str, Any]:
    """An addition; by default a slow patch that the data ask for."""
    won = gains(*changed.pop("gain", (50.0, 9.0)), **changed.pop("columns", {}))
    parameters = {"reduction": 0.2, "centre": 5.0, "width": 30.0} if name == "slow_patch" else {}
    return {
        "name": name,
        "form": name,
        "kind": kind,
        "step": 0,
        "parameters": parameters,
        "parameters_std": {"reduction": 0.01} if parameters else {},
        "covariate": None,
        "vehicles": [],
        "is_supported": True,
        "doubts": [],
        "p_value": 1e-5,
        "heldout_gain_nats": won["all"]["nats"],
        "heldout_gain_se": won["all"]["se"],
        "gains": won,
        "indistinguishable": [],
        "advice": [],
        "closest_effect": None,
        "free_run_rmse_before_m": 3.0,
        "free_run_rmse_after_m": 1.5,
        **changed,
    }


def dropped(name: str = "road_grade", **changed: Any) -> dict[str, Any]:
    """Something that the second step has added and the third one has taken out again."""
    return {
        "name": name,
        "form": name,
        "kind": "effect",
        "covariate": None,
        "step": 1,
        "dropped_in": 2,
        "free_run_rmse_before_m": 1.5,
        "free_run_rmse_after_m": 1.2,
        **changed,
    }


def force(covariate: str = "gap", sizes: Sequence[float] = (0.0, 1.0, 0.2), **changed: Any) -> dict[str, Any]:
    """A force without a name, along a covariate from 0 to 20."""
    values = {"first": 0.0, "last": 20.0, **{f"force_{k}": one for k, one in enumerate(sizes)}}
    more = {"form": f"force_along_{covariate}", "covariate": covariate, "parameters": values}
    return addition("discovered_force", "force", **{**more, **changed})


def check(name: str, value: float = 2.0, expected: float = 1.0, **changed: Any) -> dict[str, Any]:
    """A check; by default one that holds."""
    one = {"name": name, "value": value, "expected": expected, "unit": "1", "p_value": 0.4, "margin": 0.0}
    return {**one, "failed": False, **changed}


def fails(name: str, value: float = 2.0, expected: float = 1.0, **changed: Any) -> dict[str, Any]:
    """A check that fails."""
    return check(name, value, expected, **{"p_value": 0.001, "failed": True, **changed})


def errors(one_step_m: float, car_10s_m: float | None, road_10s_m: float | None = None) -> dict[str, Any]:
    """Errors of a model; without ``road_10s_m``, on tracks."""
    road = {name: road_10s_m and share * road_10s_m for name, share in (("2s_m", 0.2), ("10s_m", 1.0))}
    found = {f"free_run_{name}": value for name, value in road.items()}
    crps = {"free_run_10s_crps_m": road_10s_m and 0.5 * road_10s_m, "single_car_10s_crps_m": car_10s_m}
    return {"one_step_rmse_m": one_step_m, "loglik_per_sample": 0.4, "single_car_10s_m": car_10s_m, **found, **crps}


def document(
    outcome: str = "adequate",
    effects: Sequence[Mapping[str, Any]] = (),
    checks: Sequence[Mapping[str, Any]] = (),
    *,
    tracks: bool = False,
    **verdict: Any,
) -> dict[str, Any]:
    """A diagnosis of six cars, whole; without runs of the whole road for tracks."""
    none = {"time_s": [], "block": [], "before": [], "after": []}
    run = {
        "time_s": [0.0, 10.0, 20.0, 30.0],
        "block": [0, 0, 1, 1],
        "before": [[None, *range(5)]] * 4,
        "after": [list(range(6))] * 4,
    }
    ends = {"before": (0.4, 2.0, 3.0), "after": (0.39, 1.5, 1.5), "idm": (0.5, None, 30.0), "floor": (0.38, 1.5, 1.4)}
    found = {name: errors(*one[: 2 if tracks else 3]) for name, one in ends.items()}
    for name, won in (("before", gains(0.0, 0.0)), ("after", gains()), ("idm", gains(-500.0, 30.0))):
        found[name]["gains"] = {k: v for k, v in won.items() if not (tracks and k.startswith("road"))}
    whole = {
        "verdict": {
            "outcome": outcome,
            "effects": list(effects),
            "dropped": [],
            "asked": [],
            "searched": ["slow_patch", "drag"],
            "not_searched": [],
            "fall": {"physics_m": 1.5, "other_m": 0.0},
            **verdict,
        },
        "candidates": [
            {
                "name": name,
                "form": name,
                "kind": "effect",
                "gain_nats": gain,
                "p_value": 0.5,
                "heldout_gain_nats": gain,
                "heldout_gain_se": 9.0,
            }
            for name, gain in (("slow_patch", 50.0), ("road_grade", 45.0), ("drag", 2.0))
        ],
        "checks": [check("bias_over_gap"), check("mean_speed", 5.0, 5.1, unit="m/s"), *checks],
        "where": {"before": WHERE, "after": WHERE},
        "smallest_detectable": [{"name": "reaction_delay", "parameter": "delay", "value": 0.05}],
        "errors": found,
        "drivers": [
            {
                "vehicle": v,
                "heldout_gain_nats": 8.0,
                "single_car_10s_before_m": 2.0,
                "single_car_10s_after_m": 1.5 if v else 2.5,
                "v_star": 10.0 + v,
                "v_star_std": 0.1,
                "kappa_v": 0.2,
                "kappa_v_std": None,
            }
            for v in range(6)
        ],
        "free_run": none if tracks else run,
        "about": ABOUT,
        "vehicles": 6,
        "drivers_left_out": 0,
        "decision_period_s": 0.3,
        "decisions_per_sample": 1,
        "counted_every_s": 0.3,
        "smoothed_s": 0.0,
        "has_other_noises": False,
    }
    return copy.deepcopy(whole)
