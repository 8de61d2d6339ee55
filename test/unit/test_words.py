"""What the words of a diagnosis and of a comparison must say, and what they must never say."""

import re

import pytest
from diagnoses import addition, check, document, dropped, fails, force

from sugiyama_ros.effects.registry import EFFECTS
from sugiyama_ros.page.checks import reasons
from sugiyama_ros.page.names import model_name, short_name
from sugiyama_ros.page.tables import steps
from sugiyama_ros.page.words import (
    badge,
    equation,
    gain_in_words,
    headline,
    how_sure,
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
    assert fall == "The error of a forecast over 10 s falls, 3.00 m -> 1.50 m: all of it by physical effects."
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
    assert ": none of it by physical effects." in told
    assert "is explained" not in told
    assert "[kappa_c free], kappa_c = 1.9 ± 0.1 m" in told
    assert "Do not take it for a cause" in what_to_do(d)


def test_an_error_that_grows_is_told_first() -> None:
    d = document("not_explained", [CONSTANTS])
    d["errors"]["after"]["free_run_10s_m"] = 3.2
    assert sentences(d)[1] == "The error of a forecast over 10 s does not fall: 3.00 m -> 3.20 m."


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
    assert headline(d).startswith(
        "Not explained: slower stretch of road (slow_patch) is missing, and so is something else."
    )
    assert headline(d).endswith("The model still fails 3 of 6 checks.")
    place = "bias over the place: 6.3 predicted standard deviations, in the model's own simulations 1.1"
    assert reasons(d) == [
        f"{place} (p < 0.001)",
        "force without a name along the time gap (discovered_force:time_gap) would still gain 30 nats on unseen"
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


def test_traffic_that_stands_still_is_the_verdict_before_all_other_failures() -> None:
    bad = [fails("bias_over_place", 6.3, 1.1, p_value=1e-9)]
    d = document("not_explained", [addition()], bad)
    d["checks"][1] |= {"value": 2.94, "expected": 0.23, "p_value": 0.003, "failed": True}
    stands = "in the model's own simulations the traffic stands still (mean speed 0.23 m/s, measured 2.94 m/s)."
    assert headline(d) == (
        f"Not explained: {stands} Slower stretch of road (slow_patch) is missing, and so is something else."
        " The model still fails 2 of 3 checks."
    )
    assert reasons(d)[0] == "mean speed: 2.94 m/s, in the model's own simulations 0.23 m/s (p 0.003)"
    assert what_to_do(d).startswith("Look first at the strongest failed check, mean speed.")
    assert stands in headline({**d, "verdict": {**d["verdict"], "effects": []}})
    # traffic that is slow, that stands in the recording too, or that only chance makes stand
    for changed in ({"expected": 0.6}, {"value": 0.3}, {"failed": False}):
        other = document("not_explained", [addition()], bad)
        other["checks"][1] = {**d["checks"][1], **changed}
        assert "stands still" not in headline(other)
        assert reasons(other)[0].startswith("bias over the place")


def test_many_effects_and_what_is_missing_beside_them() -> None:
    bad = [fails("bias_over_place")]
    two = document("not_explained", [addition(), addition("drag")], bad)
    assert "slower stretch of road (slow_patch) and drag are missing, and so is something else." in headline(two)
    four = [addition(name) for name in ("slow_patch", "drag", "road_grade", "external_push")]
    assert "4 physical effects are missing, and so is something else." in headline(document("not_explained", four, bad))
    assert "4 physical effects. With them, no check fails." in headline(document("explained", four))


@pytest.mark.parametrize(
    ("physics_m", "other_m", "said"),
    [
        (1.0, 0.5, "physical effects take off 1.00 m, all else that was added takes off 0.500 m"),
        (1.75, -0.25, "physical effects take off 1.75 m, all else that was added adds 0.250 m"),
        (0.0, 1.5, "none of it by physical effects"),
    ],
)
def test_shares_of_the_fall_say_whose_they_are(physics_m: float, other_m: float, said: str) -> None:
    d = document("explained", [addition()], fall={"physics_m": physics_m, "other_m": other_m})
    assert sentences(d)[1] == f"The error of a forecast over 10 s falls, 3.00 m -> 1.50 m: {said}."


def test_errors_of_steps_chain_where_something_was_taken_out_again() -> None:
    drag = addition("drag", step=2, free_run_rmse_before_m=1.2, free_run_rmse_after_m=0.9)
    told = sentences(document("explained", [addition(), drag], dropped=[dropped()]))
    steps = [line for line in told if "; error after 10 s" in line]
    assert [re.findall(r"[\d.]+ m -> [\d.]+ m", line) for line in steps] == [
        ["3.00 m -> 1.50 m"],
        ["1.50 m -> 1.20 m"],
        ["1.20 m -> 0.900 m"],
    ]
    assert steps[1] == (
        "hill (road_grade): added; error after 10 s 1.50 m -> 1.20 m; taken out again, because it is not needed beside"
        " drag."
    )


@pytest.mark.parametrize(
    ("doubts", "gain", "said"),
    [
        (["score"], (50.0, 14.0), "does not stand out from what chance gives (p 0.21), although the fit gains"),
        (["gain"], (10.0, 14.0), "the data do not ask for it: unseen data are not forecast clearly better"),
        (["worse"], (50.0, 14.0), "the data do not ask for it: some forecasts get worse"),
        (["score", "gain"], (1.0, 8.0), "chance gives (p 0.21) and unseen data are not forecast clearly better"),
    ],
)
def test_what_the_data_do_not_ask_for_has_its_reason(doubts: list[str], gain: tuple[float, float], said: str) -> None:
    one = addition("drag", is_supported=False, doubts=doubts, gain=gain, p_value=0.21)
    d = document("explained", [one], asked=["drag"])
    for text in ("\n".join(sentences(d)), how_sure(d), gain_in_words(d, one)):
        assert said in text
        assert text.count("do not ask for it") == 1
        assert "do not confirm" not in text


def test_models_in_tables_have_short_names() -> None:
    names = {
        "base": "base",
        "base, simulated": "base, simulated",
        "base + slow_patch": "+ slow_patch",
        "base + slow_patch + drag + road_grade + drift": "+ slow_patch, drag, road_grade and 1 more",
        "file: base": "file: base",
        "file: slow_patch, drag": "file: slow_patch, drag",
        "idm_least_squares": model_name("idm_least_squares"),
    }
    assert {name: short_name(name) for name in names} == names


def test_a_form_of_what_was_added_says_that_only_some_drivers_have_it() -> None:
    ahead = check("gain_of_slow_patch_of_some", 1.5, 0.0, unit="nats", p_value=0.3)
    told = sentences(document("explained", [addition()], [ahead]))
    said = "Slower stretch of road (slow_patch) of some drivers gains 1.5 nats more on unseen data (p 0.3)"
    assert f"{said}: it may be ahead by chance." in told


def test_nothing_that_explains_a_model_that_fails() -> None:
    d = document("not_explained", checks=[fails("correlation_of_innovations", 0.2, 0.0)])
    assert headline(d) == "Not explained: the model fails 1 of 3 checks, and no effect that was tried explains it."
    assert badge(d)[0] == "✗"


def test_tracks_are_told_by_errors_of_one_car() -> None:
    missed = [{"name": "external_push", "reason": "stretches have no time in common"}]
    d = document("explained", [addition()], tracks=True, not_searched=missed)
    told = sentences(d)
    assert told[1].startswith("The error of a forecast over 10 s falls, 2.00 m -> 1.50 m: ")
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
