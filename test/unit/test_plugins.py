"""Extensions of other packages that cannot be loaded are left out, and named where somebody asks for them."""

from collections.abc import Callable
from typing import Any

import pytest

from sugiyama_ros import plugins
from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ENVIRONMENT, Effect
from sugiyama_ros.errors import InputError
from sugiyama_ros.laws.law import Law


def strength(name: str = "strength", lower: float = 0.0, upper: float = 1.0) -> Parameter:
    return Parameter(name, "f", "1", 0.0, lower, upper, "how strong")


def effect(**changed: Any) -> Effect:
    given = {"name": "mine", "stage": ENVIRONMENT, "summary": "", "source": "", "parameters": (strength(),)}
    return Effect(**(given | changed))


class Point:
    """An entry point."""

    def __init__(self, load: Callable[[], Any]) -> None:
        self.name, self.value, self.load = "mine", "mine:EFFECT", load


def fails(error: BaseException) -> Callable[[], Any]:
    def load() -> Any:
        raise error

    return load


BROKEN = {
    "raises": fails(RuntimeError("broken")),
    "exits": fails(SystemExit(0)),
    "an error of its own": fails(BaseException("odd")),
    "no effect": lambda: "text",
    "no name": lambda: effect(name=7),
    "a name of two words": lambda: effect(name="two words"),
    "no parameters": lambda: effect(parameters=()),
    "parameters of another type": lambda: effect(parameters=("strength",)),
    "a parameter twice": lambda: effect(parameters=(strength(), strength())),
    "bounds the wrong way": lambda: effect(parameters=(strength(lower=2.0),)),
    "an unknown strength": lambda: effect(strengths=("other",)),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_extension_is_left_out_and_named(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    monkeypatch.setattr(plugins, "entry_points", lambda group: [Point(BROKEN[what])])
    monkeypatch.setattr(plugins, "FAILED", {})
    assert plugins.load("a.group", Effect) == {}
    with pytest.raises(InputError, match="effect mine: mine:EFFECT"):
        plugins.find({}, "a.group", "mine", "effect")


def test_a_sound_extension_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "entry_points", lambda group: [Point(effect)])
    assert set(plugins.load("a.group", Effect)) == {"mine"}


def test_ctrl_c_while_an_extension_is_loaded_ends_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "entry_points", lambda group: [Point(fails(KeyboardInterrupt()))])
    with pytest.raises(KeyboardInterrupt):
        plugins.load("a.group", Effect)


def test_laws_are_checked_too() -> None:
    with pytest.raises(InputError, match="declared twice"):
        Law("mine", "", "", "", (strength(), strength()), lambda gap, speed, leader_speed, p: 0.0)
