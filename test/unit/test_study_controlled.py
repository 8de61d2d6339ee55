"""The study of controlled cars: its intervals, its Pareto set, and what it says of a few runs."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from sugiyama_ros.studies import controlled
from sugiyama_ros.studies.controlled import STUDY, difference, pareto
from sugiyama_ros.studies.study import Asked


def test_differences_have_students_interval() -> None:
    values = np.random.default_rng(1).normal(3.0, 2.0, 12)
    middle, half = difference(np.append(values, np.nan))
    low, high = ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert [middle - half, middle + half] == pytest.approx([low, high], rel=1e-12)
    assert np.isnan(difference(values[:1])[1]), "one run says nothing of the spread"


def test_the_pareto_set_is_what_nobody_improves_on() -> None:
    flow, std = np.array([2.0, 3.0, 1.0, 3.0, 9.0]), np.array([2.0, 2.0, 1.0, 3.0, 9.0])
    one = np.array([0, 1, 1, 1, 1])
    assert pareto(flow, std, one).tolist() == [False, True, True, False, True]
    # as many cars are compared with each other, and all of them with nobody
    assert pareto(flow, std, np.array([0, 1, 1, 2, 2])).tolist() == [False, True, True, True, True]
    assert pareto(np.array([5.0, 4.0]), np.array([1.0, 2.0]), np.array([0, 1])).tolist() == [True, False]
    assert pareto(np.array([5.0, np.nan]), np.array([1.0, np.nan]), np.array([0, 1])).tolist() == [True, False]


def test_one_car_makes_flow_and_smoothness_better(monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure

    monkeypatch.setattr(controlled, "_CARS", (1,))
    monkeypatch.setattr(controlled, "_CONTROLLERS", {"follower_stopper": ["target=5", "target=7"]})
    with ThreadPoolExecutor(1) as work:
        answer = STUDY.answer(Asked(None, 3, 900, work))
    nobody, slow, good = answer.rows
    assert [row["case"] for row in answer.rows] == [
        "nobody",
        "1 follower_stopper:target=5",
        "1 follower_stopper:target=7",
    ]
    assert nobody["waves"] == 3
    assert good["against nobody"] == "more flow and smoother"
    assert slow["against nobody"] == "less flow and smoother"
    assert good["Pareto"] == "yes"
    assert good["in draws"] == 1.0
    assert good["more"] == pytest.approx(good["flow [1/h]"] - nobody["flow [1/h]"])
    figure = Figure()
    monkeypatch.setattr(figure, "subplots", lambda *shape, **shared: [figure.add_subplot()])
    answer.draw(figure)
    assert len(figure.axes) == 1
