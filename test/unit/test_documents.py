"""Documents that are damaged, crafted or of another kind are refused with one line, in bounded time and memory."""

import copy
import itertools
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnoses import addition, document, dropped

from sugiyama_ros.diagnosis.rounds import Round
from sugiyama_ros.driver.parameters import NAMES, defaults
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.model_file import read_model
from sugiyama_ros.page.diagnosis import read_diagnosis
from sugiyama_ros.page.document import dropped_again
from sugiyama_ros.page.panels.diagnosed import candidates, growth

PARAMETERS = dict(zip(NAMES, defaults().tolist(), strict=True))
MODEL = {
    "sugiyama_model": 1,
    "data": {"source": "a", "sha256": "b"},
    "drivers": {0: {"parameters": PARAMETERS, "effects": {"drag": {"c0": 0.3}}}},
    "classes": [{"share": 1.0, "parameters": PARAMETERS}],
}
ALIASES = "a: &a [x, x]\nb: &b [*a, *a, *a, *a, *a, *a, *a, *a]\nc: [*b, *b, *b, *b, *b, *b]\n"
DIAGNOSIS: dict[str, Any] = {
    **{name: [one[0]] for name, one in document().items() if name in ("candidates", "checks", "drivers")},
    "verdict": {"outcome": "explained", "effects": [addition()], "dropped": [dropped()]},
    "smallest_detectable": [{"name": "reaction_delay", "parameter": "delay", "value": 0.05}],
    "errors": {"before": {"one_step_rmse_m": 0.4, "free_run_2s_m": 0.5}, "after": {"one_step_rmse_m": 0.39}},
}
JUNK = (None, True, "text", 7, -1.5, math.nan, math.inf, 10**400, [], {}, [[]], {"a": 1}, ["x"] * 3)


def yaml_of(value: Any) -> str:
    """JSON is YAML, except for NaN, infinite numbers and keys that are numbers."""
    text = json.dumps(value).replace("NaN", ".nan").replace("Infinity", ".inf")
    return text.replace('"0":', "0:")


def places(document: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to everything in a document."""
    inside = (
        document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    )
    return [at, *(place for key, value in inside for place in places(value, (*at, key)))]


def changed(document: Any, place: tuple[Any, ...], value: Any) -> Any:
    if not place:
        return value
    document = copy.deepcopy(document)
    inside = document
    for key in place[:-1]:
        inside = inside[key]
    inside[place[-1]] = value
    return document


def read_or_refuse(read: Any, path: Path) -> Any:
    """What is read, or None; any other error than an InputError with one line fails the test."""
    found, said = None, f"{path}: "
    try:
        found = read(path)
    except InputError as error:
        said = str(error)
    assert said.startswith(str(path))
    assert "\n" not in said
    return found


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("Drivers",), {}, r"'Drivers' is not known; did you mean drivers\?"),
        (("decision_period",), 0.5, r"'decision_period' is not known; did you mean decision_period_s\?"),
        (("road",), {"ring": 50.0}, r"road: 'ring' is not known; did you mean ring_m\?"),
        (("drivers",), "abc", "drivers: give the parameters of each driver by the number of the vehicle"),
        (("drivers", 0, "lenght_m"), 4.0, r"drivers: 0: 'lenght_m' is not known; did you mean length_m\?"),
        (("drivers", 0, "length_m"), 100.1, r"drivers: 0: length_m: 100\.1 is not possible; give 0\.01 to 100"),
        (("drivers", 0, "effects"), [], r"drivers: 0: effects: is '\[\]'; give names with their values"),
        (
            ("drivers", 0, "parameters", "V_star"),
            9.0,
            r"drivers: 0: parameters: 'V_star' is not known; did you mean v_star\?",
        ),
        (("drivers", 0, "law"), {"idm": {}, "ovm": {}}, "drivers: 0: law: gives idm, ovm; a driver has one law"),
        (("classes", 0, "shar"), 1.0, r"classes: 'shar' is not known; did you mean share\?"),
        (
            ("population",),
            {"v_star": {"median": -1.0, "log_std": 0.1}},
            "population: parameter v_star: -1 m/s is out of",
        ),
        (("population",), {"v_star": {"median": 9.0, "log_std": -1.0}}, "population: v_star: log_std: -1 is not"),
        (("goals",), [{"name": None, "place": 9.0}], "goals: name: is 'None'; give letters"),
    ],
)
def test_what_a_model_file_does_not_know_is_refused_where_it_stands(
    tmp_path: Path, place: tuple[Any, ...], value: Any, said: str
) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(yaml_of(changed(MODEL, place, value)))
    with pytest.raises(InputError, match=f"model.yaml: {said}"):
        read_model(path)


def test_a_model_is_read_or_refused_whatever_stands_in_each_field(tmp_path: Path) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(yaml_of(MODEL))
    assert read_model(path).effects == ("drag",)
    refused = 0
    for place in places(MODEL):
        for value in JUNK:
            path.write_text(yaml_of(changed(MODEL, place, value)))
            model = read_or_refuse(read_model, path)
            refused += model is None
            assert model is None or np.isfinite(model.rows).all()
    assert refused > 300


@pytest.mark.parametrize("key", [".inf", ".nan", "-1", "1.5", "4294967296", "1" + "0" * 400, "true", "null", "text"])
def test_a_vehicle_has_a_number_that_ros_can_send(tmp_path: Path, key: str) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(yaml_of(MODEL).replace("{0:", "{" + key + ":"))
    with pytest.raises(InputError, match="drivers"):
        read_model(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 100_000, "deep"),
        ("{a: " * 5000, "deep"),
        (ALIASES, "aliases"),
        ("a: 2001-99-99", "is no YAML"),
        ("\t", "YAML"),
        ("a: !!int ''", "is no YAML"),
        ("? [1]\n: 2", "is no YAML"),
        ("a: b: c", r"model.yaml:1: is no YAML: mapping values are not allowed"),
        ("a: 1\nb: {c: 1, d: 2,\n  c: 3}", r"model.yaml:3: 'c' is given twice; give it once"),
        ("a: [{b: 1}, {b: 1}]\nb: 1\na: 2", r"model.yaml:3: 'a' is given twice"),
        ("x: \x00", "is no YAML: control characters are not allowed"),
    ],
)
def test_crafted_yaml(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "model.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_model(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "diagnosis.json:1: is no JSON: Expecting property name"),
        ('{"a": 1,\n "b": {"c": 1, "c": 2}}', "'c' is given twice; give it once"),
    ],
)
def test_crafted_json(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "diagnosis.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_diagnosis(path)


def test_a_diagnosis_is_read_or_refused_whatever_stands_in_each_field(tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.json"
    refused = 0
    for place in places(DIAGNOSIS):
        for value in JUNK:
            path.write_text(json.dumps(changed(DIAGNOSIS, place, value)))
            found = read_or_refuse(read_diagnosis, path)
            refused += found is None
            if found is not None:
                candidates(found), growth(found, "free_run", "")
    assert refused > 200
    path.write_text(json.dumps(DIAGNOSIS))
    assert read_diagnosis(path) == DIAGNOSIS


def test_a_model_file_names_the_effect_that_is_not_installed(tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text(yaml_of(MODEL).replace("drag", "syrup"))
    with pytest.raises(InputError, match=r"model.yaml: drivers: 0: effect 'syrup': not known here; was its package"):
        read_model(path)


def test_what_a_later_step_takes_out_again_is_in_the_document(monkeypatch: pytest.MonkeyPatch) -> None:
    patch, grade, drag = (
        SimpleNamespace(mechanism=name, effect=name, kind="effect") for name in ("slow_patch", "road_grade", "drag")
    )
    entries = [
        SimpleNamespace(forecasts=error_m, added=added)
        for error_m, added in ((12.0, ()), (6.0, (patch,)), (5.0, (patch, grade)), (3.0, (patch, drag)))
    ]
    monkeypatch.setattr("sugiyama_ros.page.document.errors", lambda error_m: {"free_run_10s_m": error_m})
    steps = [Round(now, (), None, {}, then, {}) for now, then in itertools.pairwise(entries)]  # type: ignore[arg-type]
    (found,) = dropped_again(SimpleNamespace(steps=steps))  # type: ignore[arg-type]
    assert (found.name, found.step, found.dropped_in) == ("road_grade", 1, 2)
    assert (found.free_run_rmse_before_m, found.free_run_rmse_after_m) == (6.0, 5.0)
