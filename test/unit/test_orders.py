"""Searches in both orders, where an effect and freed constants compete for the first place."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from sugiyama_ros.diagnosis import orders
from sugiyama_ros.diagnosis.addition import Addition
from sugiyama_ros.diagnosis.looks import Looks
from sugiyama_ros.diagnosis.screen import QUICK, Screened
from sugiyama_ros.diagnosis.search import Search
from sugiyama_ros.fit.cross_validation import Gain

KINDS = {"response_constants": "constants", "drag": "effect", "outlier_noise": "measurement", "road_grade": "effect"}


class Begun:
    """A search that adds what it is told to, one after the other."""

    def __init__(self, *names, other=None):
        self.data, self.errors = None, SimpleNamespace(samples=names)
        self.left, self.named, self.other_order = list(names), [], other

    def add_effect(self):
        if self.left:
            name = self.left.pop(0)
            self.named.append(Addition(name, KINDS[name], {}, (), (), 0.0, None, None, None, None, name))
        return bool(self.left)

    def forces(self, level):
        return []

    def add_force(self, forces):
        return False


@pytest.mark.parametrize(
    ("nats", "first", "also"),
    [
        (25.0, "response_constants", ()),
        (15.0, "drag", ("response_constants",)),
        (-5.0, "drag", ("response_constants",)),
        (-15.0, "drag", ()),
    ],
)
def test_the_order_that_predicts_better_wins_and_an_equal_one_is_told(monkeypatch, nats, first, also):
    asked = []

    def gain(data, ours, theirs):
        asked.append((ours, theirs))
        return Gain(nats, 10.0, (), ())

    monkeypatch.setattr(orders, "gain", gain)
    other = Begun("response_constants", "drag")
    best = orders.grown(Begun("drag", "outlier_noise", other=other), 3, add_forces=True)
    assert asked == [(("response_constants", "drag"), ("drag", "outlier_noise"))]
    assert (best.named[0].name, best.named[0].indistinguishable) == (first, also)
    assert len(best.named) == 2


@pytest.mark.parametrize(
    ("nats", "worse", "other_worse", "first"),
    [
        (15.0, "10-s runs", "", "response_constants"),
        (15.0, "10-s runs", "10-s runs", "drag"),
        (15.0, "", "", "drag"),
        (5.0, "10-s runs", "", "drag"),
    ],
)
def test_constants_before_an_effect_take_one_standard_error_if_their_model_alone_holds_in_use(
    monkeypatch, nats, worse, other_worse, first
):
    monkeypatch.setattr(orders, "gain", lambda data, ours, theirs: Gain(nats, 10.0, (), ()))
    searches = Begun("drag"), Begun("response_constants")
    for search, told in zip(searches, (worse, other_worse), strict=True):
        search.add_effect()
        search.named[0] = replace(search.named[0], worse=(told,) if told else ())
    searches[0].other_order = searches[1]
    assert orders.grown(searches[0], 1, add_forces=False).named[0].name == first


def test_an_effect_before_constants_takes_one_standard_error(monkeypatch):
    monkeypatch.setattr(orders, "gain", lambda data, ours, theirs: Gain(15.0, 10.0, (), ()))
    best = orders.grown(Begun("response_constants", other=Begun("drag")), 3, add_forces=False)
    assert [one.name for one in best.named] == ["drag"]


def test_without_another_order_a_search_goes_on_to_its_limit():
    best = orders.grown(Begun("drag", "outlier_noise", "road_grade"), 2, add_forces=False)
    assert [one.name for one in best.named] == ["drag", "outlier_noise"]


def addition(name, nats):
    won = Gain(nats, 1.0, (), ())
    return Addition(name, KINDS[name], {}, (), (), 0.0, won, None, None, name, name)


def test_both_orders_begin_with_a_memory_of_their_own():
    search = Search.__new__(Search)
    search.named, search.refused, search.senseless = [], [], {}
    search._looks, search._few_gained = Looks(None, "base", None, QUICK), {"drag": 1.0}
    search._use = SimpleNamespace(worse=lambda additions, fitted, before: (), refuses=False)
    search.current, search._possible = "base", ()
    drag, more, less = addition("drag", 9.0), addition("response_constants", 8.0), addition("outlier_noise", 7.0)
    other = search._with_constants_elsewhere(drag, [drag, less, more])
    assert ([one.name for one in other.named], other.current) == (["response_constants"], "response_constants")
    assert (search.named, search.current) == ([], "base")
    other._looks.keep([Screened(SimpleNamespace(name="road_grade"), None, 0.0, 0.0)], "base")
    other._few_gained["road_grade"] = 1.0
    assert search._looks.is_first_round
    assert "road_grade" not in search._few_gained
    # what begins with constants is compared with what begins with an effect
    assert search._with_constants_elsewhere(more, [more, drag]).named[0].name == "drag"
    assert search._with_constants_elsewhere(drag, [drag, less]) is None
