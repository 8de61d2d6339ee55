"""What the words of a diagnosis and of a comparison must say, and what they must never say."""

import pytest
from diagnoses import addition, check, document, fails, force

from sugiyama_ros.effects.registry import EFFECTS
from sugiyama_ros.page.tables import steps
from sugiyama_ros.page.words import (
    badge,
    equation,
    headline,
    how_sure,
    reasons,
    sentences,
    size_of,
    what_to_do,
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
