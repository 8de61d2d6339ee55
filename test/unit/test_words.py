"""What the words of a diagnosis and of a comparison must say, and what they must never say."""

from typing import Any

import pytest
from diagnoses import addition, check, document, errors, fails, force, gains

from sugiyama_ros.effects.registry import EFFECTS
from sugiyama_ros.page.names import distances, quantity
from sugiyama_ros.page.tables import by_driver, compared, steps
from sugiyama_ros.page.words import (
    badge,
    best_model,
    cautions,
    equation,
    headline,
    how_sure,
    reasons,
    sentences,
    size_of,
    what_to_do,
    worse,
)

CONSTANTS = addition(
    "response_constants",
    "constants",
    parameters={"kappa_c": 1.9},
    parameters_std={"kappa_c": 0.1},
    closest_effect={"name": "drag", "behind_nats": 12.0, "behind_se": 5.0},
)


def test_an_adequate_model_is_praised_no_further_than_the_data_go() -> None:
    d = document()
    assert sentences(d)[0] == "The model is adequate: no check fails."
    assert badge(d)[0] == "✓"
    told = "\n".join(sentences(d))
    assert "Effects of this strength would usually have shown: reaction delay (delay: 0.05 or more)." in told
    assert "2 of 2 checks hold." in told
    assert "The base model is biased in 1 of 2 bins, most of all: while braking (-0.20 std)." in told
    for word in ("added", "explained", "brackets", "error after 10 s"):
        assert word not in told
    assert [row[0] for row in steps(d).rows] == ["base model", "IDM", "floor (simulated)"]


def test_an_effect_that_explains_has_its_name_its_size_and_its_doubts() -> None:
    patch = addition(indistinguishable=["road_grade"], advice=["survey the road"], columns={"at_1s": (-2.0, 6.0)})
    d = document("explained", [patch])
    first, fall, line, *rest = sentences(d)
    assert first.startswith(
        "What was missing is explained: slower stretch of road (slow_patch). With it, no check fails."
    )
    assert fall == "The error after 10 s falls, 3.00 m -> 1.50 m; physical effects bring all of it."
    assert line == (
        "slower stretch of road (slow_patch): share taken off the desired speed: 0.20 ± 0.01; middle: 5 m; length:"
        " 30 m. On unseen data 50 ± 9 nats better (5.6 standard errors); p < 0.001; error after 10 s 3.00 m -> 1.50 m."
    )
    assert "  It cannot be told apart from hill (road_grade). To tell them apart, survey the road." in rest
    assert "  Gets worse: within chance: one car at 1 s -2 ± 6 nats." in rest
    assert not any("asked" in one for one in rest)
    assert what_to_do(d) == "To tell apart what cannot be told apart, survey the road."
    assert how_sure(d).endswith("; cannot be told apart from hill (road_grade).")


@pytest.mark.parametrize("behind", [12.0, -7.0])
def test_constants_never_explain_and_the_closest_effect_stands_beside_them(behind: float) -> None:
    closest = {"name": "drag", "behind_nats": behind, "behind_se": 5.0}
    d = document("not_explained", [{**CONSTANTS, "closest_effect": closest}], fall={"physics_m": 0.0, "other_m": 1.5})
    assert badge(d) == ("✗", "Not explained")
    assert headline(d).startswith(
        "Not explained: these drivers do not have the paper's constants: softer or harder response (response_constant"
    )
    near = {12.0: "comes closest, drag, is 12 ± 5 nats behind", -7.0: "drag gains 7 ± 5 nats more, but cannot be added"}
    told = "\n".join(sentences(d))
    assert near[behind] in headline(d)
    assert told.count(near[behind]) == 1
    assert "physical effects bring none of it" in told
    assert "is explained" not in told
    assert "[kappa_c free], kappa_c = 1.9 ± 0.1 m" in told
    assert "Do not take it for a cause" in what_to_do(d)


def test_an_error_that_grows_is_told_first() -> None:
    d = document("not_explained", [CONSTANTS])
    d["errors"]["after"]["free_run_10s_m"] = 3.2
    assert sentences(d)[1] == "The error after 10 s does not fall: 3.00 m -> 3.20 m."


def test_what_was_asked_for_and_is_not_supported_says_so_and_which_columns_get_worse() -> None:
    asked = addition(
        "drag",
        is_supported=False,
        p_value=0.4,
        gain=(1.0, 8.0),
        columns={"at_5s": (-30.0, 6.0), "road_10s": (-1.0, 6.0)},
    )
    d = document("explained", [asked], asked=["drag"])
    assert badge(d) == ("?", "Added as asked; the data do not ask for it")
    told = "\n".join(sentences(d))
    assert headline(d).startswith("You asked for drag; the data do not.")
    assert "is explained" not in told
    assert "  Gets worse: one car at 5 s -30 ± 6 nats; within chance: all cars at 10 s -1 ± 6 nats." in told
    assert what_to_do(d).startswith("Leave it out")
    assert "other effects were not fitted" in how_sure(d)
    # the same on a model that fails: still no name
    d = document("not_explained", [asked], [fails("wave_speed", -7.0, -12.0, unit="m/s")], asked=["drag"])
    assert badge(d)[1] == "Not explained"
    assert headline(d).endswith("The model fails 1 of 3 checks: something else is missing.")


def test_a_force_has_no_name_and_explains_nothing() -> None:
    d = document("not_explained", [force()])
    assert headline(d).startswith("Not explained: a force helps that has no name: force without a name along the gap")
    assert "(discovered_force:gap)" in headline(d)
    assert size_of(d, force()) == "0 to 1 m/s² along the gap, from 0 to 20 m"
    assert equation(d) == "a = abar(gap, v, v_lead; v*, kappa_v) [+ force(gap)]"


def test_failed_checks_are_told_the_strongest_first_and_lead_to_what_to_do() -> None:
    bad = [
        fails("left_for_force_along_time_gap", 30.0, 0.0, unit="nats", p_value=0.002),
        fails("bias_over_place", 6.3, 1.1, p_value=1e-9),
        fails("gain_of_gipps", 40.0, 0.0, unit="nats", p_value=0.003),
        check("gain_of_idm", 3.0, 0.0, unit="nats", p_value=0.3),
    ]
    d = document("not_explained", [addition()], bad)
    assert headline(d).startswith("Not explained: slower stretch of road (slow_patch) and more is missing.")
    assert headline(d).endswith("The model still fails 3 of 6 checks.")
    place = "bias over the place: 6.3 times what chance makes, in the model's own simulations 1.1"
    assert reasons(d) == [
        f"{place} (p < 0.001)",
        "force without a name along the time gap (discovered_force:time_gap) would still gain 30 nats on the fitted"
        " data (p 0.002)",
        "Gipps gains 40 nats more on unseen data (p 0.003)",
    ]
    told = sentences(d)
    assert f"Fails: {reasons(d)[0]}." in told
    assert "3 of 6 checks hold." in told
    assert [line for line in told if "IDM" in line] == [
        "IDM gains 3 nats more on unseen data (p 0.3): it may be ahead by chance."
    ]
    assert what_to_do(d).startswith("Look first at the strongest failed check, bias over the place.")
    assert "Do not take the names for causes" in what_to_do(d)


def test_nothing_that_explains_a_model_that_fails() -> None:
    d = document("not_explained", checks=[fails("correlation_of_innovations", 0.2, 0.0)])
    assert headline(d) == "Not explained: the model fails 1 of 3 checks, and no effect that was tried explains it."
    assert badge(d)[0] == "✗"


def test_tracks_are_told_by_errors_of_one_car() -> None:
    missed = [{"name": "external_push", "reason": "stretches have no time in common"}]
    d = document("explained", [addition()], tracks=True, not_searched=missed)
    told = sentences(d)
    assert told[1].startswith("The error after 10 s falls, 2.00 m -> 1.50 m")
    assert told[-1] == "Not searched for: push from outside (external_push): stretches have no time in common."
    assert not any("all cars" in line for line in told)
    assert steps(d).title.endswith("errors after 10 s of one car")
    assert steps(d).rows[0][-3:] == ("2.00", "2.00", "0.400")


def test_who_gets_worse_is_told_and_a_model_file_warns() -> None:
    d = document("explained", [addition()])
    assert worse(d) == ["for 1 of 6 drivers (vehicle 0), one-car free runs get more than a fifth worse"]
    assert cautions(d) == []
    d["errors"]["after"]["gains"] = gains(road_10s=(-20.0, 5.0), at_5s=(-3.0, 5.0))
    assert cautions(d) == ["forecasts get worse than the base model's: all cars at 10 s -20 ± 5 nats"]
    assert worse(d)[1:] == cautions(d)
    assert len(by_driver(d).rows) == 6


def test_the_data_are_told_of_where_they_are_unusual() -> None:
    d = document()
    plain = sentences(d)
    d |= {"smoothed_s": 0.5, "counted_every_s": 1.2, "has_other_noises": True, "drivers_left_out": 4}
    assert sentences(d)[len(plain) :] == [
        "Third differences of the positions are correlated over about 0.5 s, as by a smoother: only samples that are"
        " 1.2 s apart count.",
        "The paper's noises of position and speed do not suit these vehicles: they are fitted for each.",
        "This is about 6 of 10 drivers, evenly spread over the recording: all of them would take too much memory.",
    ]
    d = document() | {"decisions_per_sample": 2, "decision_period_s": 0.4, "counted_every_s": 0.8}
    assert (
        sentences(d)[-1]
        == "Samples are 0.8 s apart; the model's drivers decide 2 times from one to the next, every 0.4 s."
    )


def test_the_equation_marks_what_is_new() -> None:
    drag = addition("drag", parameters={"c0": 0.3, "c2": 0.004}, parameters_std={"c0": 0.02})
    d = document("explained", [drag, addition()])
    assert equation(d) == (
        "a = abar(gap, v, v_lead; v*, kappa_v) [- c0 - c2 v|v|]; [v* -> v* (1 - reduction bump(x - centre, width))],"
        " c0 = 0.30 ± 0.02 m/s², c2 = 0.004 1/m, reduction = 0.20 ± 0.01, centre = 5 m, width = 30 m"
    )
    assert equation(document()) == ""
    # an effect of a plugin that declares no term
    syrup = addition("syrup", parameters={"k": 0.1}, parameters_std={})
    assert equation(document("explained", [syrup])).endswith("; [syrup(k)], k = 0.1")


@pytest.mark.parametrize("name", EFFECTS)
def test_each_term_is_short_and_names_the_parameters_of_its_effect(name: str) -> None:
    effect = EFFECTS[name]
    assert 0 < len(effect.term) <= 90
    assert effect.title


def test_small_lengths_are_told_in_millimetres() -> None:
    assert distances(0.00805, 0.00277) == ["8.05 mm", "2.77 mm"]
    assert distances(0.00805, 0.0277) == ["0.00805 m", "0.0277 m"]
    assert quantity(8.1e-6, "m") == "0.0081 mm"
    assert quantity(0.3691, "m") == "0.369 m"
    assert quantity(0.0531, "", digits=2) == "0.053"


def model(name: str, kind: str, gain: float, behind: tuple[float, float] | None) -> dict[str, Any]:
    """One model of a comparison."""
    won = gains(gain, 10.0 if gain else 0.0)
    return {
        "name": name,
        "kind": kind,
        **errors(0.4, 2.0, 3.0),
        "gains": won if behind else {},
        "heldout_gain_nats": gain if behind else None,
        "heldout_gain_se": won["all"]["se"] if behind else None,
        "behind": behind and {"nats": behind[0], "se": behind[1]},
        "collective": {},
        "drivers": [],
    }


def comparison(*models: dict[str, Any]) -> dict[str, Any]:
    return {"models": [*models, model("base, simulated", "simulated", 0.0, None)], "measured": None}


BASE = model("base", "base", 0.0, (80.0, 10.0))


def test_a_comparison_names_the_best_model_and_what_is_alike() -> None:
    best = model("base + drag", "asked", 80.0, (0.0, 0.0))
    c = comparison(BASE, best, model("idm", "law", 70.0, (10.0, 6.0)), model("gipps", "law", -300.0, (380.0, 20.0)))
    assert best_model(c) == (
        "base + drag forecasts unseen data best, 80 ± 10 nats better than the base model. It cannot be told apart from"
        " IDM."
    )
    c = comparison(BASE, best, model("idm", "law", 30.0, (50.0, 6.0)))
    assert best_model(c).endswith("; IDM is 50 ± 6 nats behind.")
    best = model("base + slow_patch", "asked", 80.0, (0.0, 0.0))
    assert best_model(comparison(BASE, best)).startswith("base + slower stretch of road (slow_patch) forecasts")


def test_no_model_beats_the_base_model() -> None:
    base = model("base", "base", 0.0, (0.0, 0.0))
    c = comparison(base, model("idm", "law", -30.0, (30.0, 6.0)))
    assert best_model(c) == (
        "No other model forecasts unseen data better than the base model; IDM is 30 ± 6 nats behind."
    )


def test_a_model_in_sample_never_counts() -> None:
    own = model("file: drag", "in_sample", 500.0, (-420.0, 20.0))
    c = comparison(BASE, own, model("idm", "law", 80.0, (0.0, 0.0)))
    said = best_model(c)
    assert said.startswith("file: drag was fitted to these samples, so it does not count here. IDM forecasts")
    assert "in sample" in compared(c).title
    assert [row[0] for row in compared(c).rows] == ["file: drag", "IDM", "base"]


def test_six_rows_are_shown_first_and_all_on_demand() -> None:
    laws = [model(name, "law", -10.0 * k, (80.0 + 10.0 * k, 5.0)) for k, name in enumerate("abcdefgh", 1)]
    c = comparison(BASE, model("base + drag", "asked", 80.0, (0.0, 0.0)), *laws)
    assert [row[0] for row in compared(c).rows] == ["base + drag", "base", "a", "b", "c", "d"]
    everything = [row[0] for row in compared(c, show_all=True).rows]
    assert everything == ["base + drag", "base", *"abcdefgh", "base, simulated"]
    assert compared(c).headings == (
        "model", "gain", "one step", "2 s", "5 s", "10 s", "CRPS 10 s [m]", "error 10 s [m]", "one step [m]",
    )  # fmt: skip
