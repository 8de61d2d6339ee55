"""The door of the Python interface: whatever is given, the answer is a result or one line that names the argument."""

import inspect
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import sugiyama_ros as sg
from sugiyama_ros.arguments import Numbers, checked
from sugiyama_ros.errors import InputError, OutputError
from sugiyama_ros.simulation.experiment import Experiment

#: Values that fit somewhere, nowhere, or only by their type.
ODD: tuple[Any, ...] = (
    None,
    True,
    -1,
    10**400,
    2**63,
    1e308,
    -0.5,
    float("nan"),
    float("inf"),
    1j,
    "",
    "nonsense",
    "\0",
    "a" * 300,
    b"bytes",
    [],
    (),
    {},
    {"nonsense": 1},
    {1: 2},
    {"drag": 3},
    {"drag": {"c0": "x"}},
    {0: (1, 2, 3)},
    {"v_star": float("nan")},
    [None],
    ["nonsense"],
    [[1], [2, 3]],
    set("ab"),
    range(3),
    object(),
    len,
    int,
    Decimal(1),
    Fraction(1, 2),
    Path("nonsense"),
    np.float32(1.5),
    np.int64(-3),
    np.bool_(True),
    np.array(7),
    np.zeros(0),
    np.zeros((2, 2)),
    np.array(["a"]),
    pd.DataFrame(),
    pd.DataFrame({"a": [1]}),
    pd.Series([1.0, 2.0]),
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    sg.simulate(vehicles=2, ring_m=0.0, duration_s=4.0).save(path)
    return path


def calls(run: Path) -> dict[str, dict[str, Any]]:
    """Short calls of each public function that work; other arguments are put in place of theirs."""
    tracks = sg.simulate(vehicles=3, ring_m=0.0, duration_s=12.0, seed=1).measured
    road = run.with_name("road.csv")
    road.write_text("lane,x_m,y_m\na,0,0\na,50,0\n")
    line = [[0.0, 0.0], [50.0, 0.0]]
    return {
        "read": {"source": run},
        "simulate": {"vehicles": 2, "duration_s": 2.0},
        "calibrate": {"tracks": tracks},
        "compare": {"tracks": tracks},
        "diagnose": {"tracks": tracks},
        "filter_plane": {"x_m": [1.0, 2.0], "y_m": [0.0, 0.0], "line": line, "period_s": 0.1},
        "read_recording": {"path": run},
        "read_road": {"path": road},
        "report": {"run": run, "output": run.with_name("page.html")},
        "lane_changes": {"tracks": tracks},
        "simulate_lane_changes": {"vehicles": 4, "lanes": 2, "duration_s": 2.0},
    }


#: Arguments behind ``**``.
SETTINGS = {
    "simulate": tuple(Experiment.__dataclass_fields__),
    "calibrate": ("classes", "goals", "seed", "law", "scheduler"),
}
#: A file, an effect or a goal is named as it was given; of recordings and arrays, what they lack is said.
NAMED_BY_VALUE = (
    "source",
    "path",
    "run",
    "output",
    "diagnosis",
    "model",
    "columns",
    "road",
    "add",
    "tracks",
    "x_m",
    "spans",
)
NAMED_BY_VALUE += ("calibration", "name")
TAKE_LONG = ("duration_s", "vehicles", "lanes", "simulations", "horizon")
FUNCTIONS = [name for name in sg.__all__ if inspect.isfunction(getattr(sg, name))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_whatever_is_given_is_taken_or_refused_in_one_line_that_names_the_argument(
    name: str, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    function, works = getattr(sg, name), calls(run)[name]
    arguments = [one for one in inspect.signature(function).parameters if one != "settings"]
    refused = 0
    for argument in (*arguments, *SETTINGS.get(name, ())):
        for value in ODD:
            # what is as large as this takes its time
            if argument in TAKE_LONG and isinstance(value, int | float) and value > 1000:
                continue
            try:
                function(**{**works, argument: value})
            except (InputError, OutputError) as error:
                text = str(error)
                assert "\n" not in text
                assert len(text) < 1100
                fits_not = "is not possible; give" in text and text.startswith(f"{argument}: ")
                refused += fits_not
                assert fits_not or argument in NAMED_BY_VALUE or argument.split("_")[0].rstrip("s") in text, text
    assert refused >= 15 * len(arguments)


def test_an_unknown_or_missing_keyword_is_an_error_of_type() -> None:
    with pytest.raises(TypeError, match="nonsense"):
        sg.compare(sg.simulate(vehicles=2, duration_s=2.0), nonsense=1)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="missing a required argument: 'line'"):
        sg.filter_plane([0.0], [0.0])  # type: ignore[call-arg]


@pytest.mark.parametrize("given", ["", ["", "a.csv"]])
def test_an_empty_name_is_not_the_folder_of_the_process(given: Any) -> None:
    with pytest.raises(InputError, match="source: is empty; give the name of a file or a folder"):
        sg.read(given)


def test_numbers_of_any_kind_are_the_same_number() -> None:
    expected = sg.simulate(vehicles=3, ring_m=50.0, duration_s=10.0, seed=4).position_m
    for number, whole in ((int, np.int64), (np.float32, np.uint8), (np.float64, np.int32), (np.array, np.array)):
        ring_m: Any = number(50)
        found = sg.simulate(vehicles=whole(3), ring_m=ring_m, duration_s=number(10), seed=whole(4))  # type: ignore[arg-type]
        assert np.array_equal(found.position_m, expected)
    open_road = sg.simulate(vehicles=3, ring_m=0, duration_s=10, seed=4, gap_m=5)
    assert not open_road.dense.road.is_ring
    assert open_road.dense.position_m.dtype == np.float64


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"ring_m": "50"}, r"ring_m: '50' is not possible; give float$"),
        ({"vehicles": 2.5}, r"vehicles: 2.5 is not possible; give int$"),
        ({"vehicles": True}, r"vehicles: True is not possible; give int$"),
        ({"parameters": ["v_star"]}, r"parameters: \['v_star'\] is not possible; give mapping of str to float$"),
        ({"controlled": "0"}, r"controlled: '0' is not possible; give sequence of int$"),
        ({"controlled": [0.5], "controller": "constant_speed"}, r"controlled: \[0.5\] is not possible"),
        ({"start": None}, r'start: None is not possible; give \{"jam", "equal"\}$'),
    ],
)
def test_a_wrong_type_is_told_with_the_type_of_the_docstring(arguments: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told):
        sg.simulate(**arguments)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_door_keeps_signature_and_docstring(name: str) -> None:
    function = getattr(sg, name)
    inner = inspect.unwrap(function)
    assert inner is not function
    assert inspect.signature(function) == inspect.signature(inner)
    assert function.__doc__ == inner.__doc__
    assert "Parameters\n    -----" in (function.__doc__ or "")


def test_arrays_are_made_of_whatever_holds_numbers() -> None:
    @checked()
    def total(x: Numbers, y: "Numbers | None" = None) -> float:
        assert isinstance(x, np.ndarray)
        return float(np.nansum(x))

    good: tuple[Any, ...] = (
        [1, 2],
        (1.0, 2.0),
        range(1, 3),
        pd.Series([1, 2]),
        np.array([1, 2], np.uint8),
        [1, None, 2],
    )
    assert [total(one) for one in good] == [3.0] * 6
    bad: tuple[Any, ...] = (None, "12", ["1"], [True, "a"], [[1], [2, 3]], {"a": 1}, object(), [1j], [b"1"])
    take: Callable[..., float] = total
    for one in bad:
        with pytest.raises(InputError, match=r"x: .* is not possible; give "):
            take(one)


def test_methods_of_results_refuse_what_they_cannot_take(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    simulated = sg.simulate(vehicles=2, ring_m=0.0, duration_s=4.0)
    tracks = simulated.measured
    acts: tuple[tuple[Callable[[Any], object], str], ...] = (
        (simulated.save, "path|nonsense|aaa|is a directory|cannot be written"),
        (tracks.save, "path|nonsense|aaa|is a directory|cannot be written"),
        (simulated.plot, "plot.ax="),
        (tracks.select, "rows: give an array of"),
        (tracks.column, "no column of tracks; choose among"),
    )
    for act, told in acts:
        for value in ODD:
            if act == simulated.plot and value is None:
                continue
            with pytest.raises((InputError, OutputError), match=told):
                act(value)
