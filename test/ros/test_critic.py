"""A hidden effect in replayed topics: the critic names it, a service adds it, and the error falls."""

from pathlib import Path

import numpy as np
import pytest
from one_driver import OneDriver
from rclpy.node import Node
from rclpy.parameter import Parameter
from sugiyama_msgs.msg import DriverParameters, Innovation, Verdict
from sugiyama_msgs.srv import AddEffect, RemoveEffect, Seek

from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, V_STAR, defaults, population
from sugiyama_ros.effects.registry import ROW, active, switch_on
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import ADAPT
from sugiyama_ros.formats.table import write_csv
from sugiyama_ros.nodes.base.qos import STREAM
from sugiyama_ros.nodes.critic import Critic
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.replay import Replay
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, simulate

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]
DRIVERS, RING_M, DELAY_S = 6, 84.0, 0.35
OWN = {"sigma_a": 0.273, "kappa_v": 0.3225}


@pytest.fixture(scope="module")
def delayed():
    """Drivers with a reaction delay on a ring. They start at speed, a wave forms, and no cars collide."""
    rng = np.random.default_rng(5)
    p = defaults(DRIVERS)
    p[:, V_STAR] *= np.exp(0.05 * rng.standard_normal(DRIVERS))
    p[:, KAPPA_V] = OWN["kappa_v"]
    rows = switch_on(ROW.with_effects(p), "reaction_delay", {"delay": DELAY_S})
    length, road = np.full(DRIVERS, 4.33), Road(RING_M)
    run = simulate(Simulator(rows, length, evenly(length, road), road, rng, speed=np.full(DRIVERS, 6.0)), 100.0)
    assert not run.collisions
    return run.dense


class Ears(Node):
    """Collects innovations, verdicts and parameters."""

    def __init__(self) -> None:
        super().__init__("ears")
        self.squares: dict[int, list[float]] = {v: [] for v in range(DRIVERS)}
        self.verdicts: list[Verdict] = []
        self.names: dict[int, list[str]] = {}
        for v in range(DRIVERS):
            self.create_subscription(Innovation, f"/vehicle_{v:02}/innovation", self._on_innovation, STREAM)
            self.create_subscription(DriverParameters, f"/vehicle_{v:02}/parameters", self._on_parameters, STREAM)
        self.create_subscription(Verdict, "/verdict", self.verdicts.append, STREAM)

    def _on_innovation(self, message: Innovation) -> None:
        self.squares[message.vehicle].append(message.innovation_m**2 if message.scored else np.nan)

    def _on_parameters(self, message: DriverParameters) -> None:
        self.names[message.vehicle] = list(message.name)

    def pass_done(self, samples: int) -> bool:
        """Whether every estimator has answered every sample."""
        return all(len(s) >= samples for s in self.squares.values())

    def rmse(self) -> float:
        """Root mean square [m] of all scored innovations since the last call."""
        value = float(np.sqrt(np.nanmean([s for squares in self.squares.values() for s in squares])))
        self.squares = {v: [] for v in range(DRIVERS)}
        return value


def batch_rmse(measured, row) -> float:
    """One-step error [m] that the batch filter expects of the estimators."""
    filtered = [filter_chain(chain_behind(measured, i), row, ADAPT, ahead(row)) for i in range(DRIVERS)]
    errors = [np.where(f.scored, f.innovation_m**2, np.nan) for f in filtered]
    return float(np.sqrt(np.nanmean(errors)))


def ahead(row):
    """Row of the drivers ahead. The estimators know only the effects that all drivers share."""
    other = ROW.with_effects(population())
    other[len(population()) :] = row[len(population()) :]
    return other


def test_a_hidden_delay_is_named_added_and_the_error_falls(stage, delayed, tmp_path: Path) -> None:
    source = tmp_path / "delayed.csv"
    write_csv(delayed, source)
    samples = len(delayed.position_m)
    driver = [Parameter(name, value=value) for name, value in OWN.items()]
    ears, critic = Ears(), Critic(parameter_overrides=driver)
    own = {"vehicles": list(range(DRIVERS)), "vehicle_topics": True}
    drivers = DriversNode(parameter_overrides=[*driver, *(Parameter(name, value=value) for name, value in own.items())])
    about = {"source": str(source), "ring": RING_M, "rate": 0.0, "wait_for": ["/critic", "/drivers"]}
    replay = Replay(parameter_overrides=[Parameter(k, value=v) for k, v in about.items()])
    stage.add(replay, critic, ears, drivers)
    stage.until(lambda: ears.pass_done(samples), 100.0)
    before = ears.rmse()
    verdict = ears.verdicts[-1]
    gains = dict(zip(verdict.model, verdict.log_likelihood, strict=True))
    assert verdict.best == "reaction_delay", gains
    assert sum(verdict.weight) == pytest.approx(1.0)
    assert verdict.samples > 0.9 * DRIVERS * samples

    request = AddEffect.Request(effect="reaction_delay", name=["delay"], value=[DELAY_S])
    assert stage.call(AddEffect, "/critic/add_effect", request).success
    stage.until(lambda: all(active(d.follower.filter.parameters) for d in drivers.drivers.values()))
    stage.until(lambda: not list(critic.clients))
    assert stage.call(Seek, "/replay/seek", Seek.Request(time_s=0.0)).success
    stage.until(lambda: ears.pass_done(samples), 100.0)
    after = ears.rmse()

    row = ROW.with_effects(population())
    row[SIGMA_A], row[KAPPA_V] = OWN["sigma_a"], OWN["kappa_v"]
    expected = [batch_rmse(delayed, r) for r in (row, switch_on(row, "reaction_delay", {"delay": DELAY_S}))]
    # the estimators learn the noises too, while the batch filter is given them: this changes the error by 0.001
    assert before - after > 0.01
    assert [before, after] == pytest.approx(expected, rel=0.005)
    assert before - after == pytest.approx(expected[0] - expected[1], rel=0.15)
    assert all(names[-1] == "reaction_delay.delay" for names in ears.names.values())


def test_effects_are_checked_added_and_removed(stage, ring_csv: Path) -> None:
    about = {"source": str(ring_csv), "ring": 100.0, "rate": 0.0, "wait_for": ["/drivers"]}
    replay = Replay(parameter_overrides=[Parameter(k, value=v) for k, v in about.items()])
    estimator = OneDriver(0)
    stage.add(replay, estimator)
    stage.until(lambda: estimator.steps == 200)

    def add(effect: str, **values: float):
        request = AddEffect.Request(effect=effect, name=list(values), value=list(values.values()))
        return stage.call(AddEffect, "/drivers/add_effect", request)

    assert "effect 'teleport': not known" in add("teleport", x=1.0).message
    assert "has no parameter 'weight'" in add("drag", weight=1.0).message
    assert "out of bounds" in add("drag", c0=99.0).message
    assert "give c0 or c2" in add("drag").message
    assert add("drag", c0=0.2).success
    assert add("second_leader", weight=0.2).success
    remove = "/drivers/remove_effect"
    assert stage.call(RemoveEffect, remove, RemoveEffect.Request(effect="drag")).success
    assert "is not in the model" in stage.call(RemoveEffect, remove, RemoveEffect.Request(effect="drag")).message


def test_nobody_who_follows_drivers_is_told(stage) -> None:
    critic = Critic()
    stage.add(critic)
    request = AddEffect.Request(effect="drag", name=["c0"], value=[0.1])
    refused = stage.call(AddEffect, "/critic/add_effect", request)
    assert (refused.success, refused.message) == (False, "no node follows drivers")
