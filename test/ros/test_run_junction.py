"""`run` on a recording of a junction: drivers let others pass at lines, and follow leaders from other ways."""

from pathlib import Path

import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from sugiyama_msgs.msg import DriverArray
from sugiyama_msgs.srv import SetDriver
from typer.testing import CliRunner

import sugiyama_ros as sg
from sugiyama_ros.cli.app import app
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.extract import drives
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.nodes.base.samples import Sample
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.replay import Replay, TrackSamples
from sugiyama_ros.nodes.run import run
from sugiyama_ros.nodes.simulator import SimulatorNode
from sugiyama_ros.nodes.view import View
from sugiyama_ros.road import Road
from sugiyama_ros.roads.examples import roundabout
from sugiyama_ros.simulation.junction import JunctionSimulator, demand, simulate_junction
from sugiyama_ros.simulation.simulator import Clock
from sugiyama_ros.trajectories.tracks import LINE, Tracks

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

COLUMNS = (*LINE, "leader_shift_m")


@pytest.fixture(scope="module")
def tracks() -> Tracks:
    """Eighteen drivers on a roundabout."""
    rng, network = np.random.default_rng(4), roundabout()
    rows, paths = defaults(18), network.ways()
    rows[:, V_STAR], rows[:, KAPPA_V] = rng.normal(11.0, 1.0, 18), 0.4
    come = demand(np.full(len(paths), 1000.0 / len(paths)), ROW.with_effects(rows), rng)
    return simulate_junction(JunctionSimulator(network, paths, come, rng, Clock(0.2)), 1000.0).measured


@pytest.fixture(scope="module")
def recorded(tracks: Tracks, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `run` records of it."""
    folder = tmp_path_factory.mktemp("junction")
    tracks.save(folder / "tracks.parquet")
    assert run(folder / "tracks.parquet", folder / "out.mcap").messages_lost == 0
    return folder / "out.mcap"


def test_a_recording_is_read_back_as_it_was(tracks: Tracks, recorded: Path) -> None:
    back = sg.read(recorded)
    assert np.isfinite(tracks.line_m).sum() > 300
    assert (np.abs(tracks.leader_shift_m) > 1.0).any()
    for name in ("s_m", "length_m", *COLUMNS):
        np.testing.assert_array_equal(back.column(name), tracks.column(name))
    np.testing.assert_allclose(back.time_s, tracks.time_s, atol=1e-9)
    np.testing.assert_array_equal(back.leader_row, tracks.leader_row)


def test_the_node_gives_the_estimates_of_the_filter_of_recordings(tracks: Tracks, recorded: Path) -> None:
    """Of drivers whose leaders all stay for a second: the filter of recordings looks ahead to leave out others."""
    told: dict[int, list[float]] = {}
    with Bag(recorded) as bag:
        for _, _, _, raw in bag.raw_messages({"/drivers"}):
            message = deserialize_message(raw, DriverArray)
            for vehicle, innovation in zip(message.vehicle, message.innovation_m, strict=True):
                told.setdefault(vehicle, []).append(innovation)
    samples, compared, lines = TrackSamples(tracks), 0, 0
    for drive in drives(tracks):
        chain, vehicle = drive.chain, int(drive.stretch.vehicle)
        if not np.array_equal(chain.identity, chains_of(samples, vehicle, chain.identity.shape[1])):
            continue
        filter_ = OnlineFilter(chain.period_s, Road())
        ours = [
            filter_.step(position, identity, length, time_s, lines=tuple(around[3:])).innovation_m
            for position, identity, length, time_s, around in zip(
                chain.position_m,
                chain.identity,
                chain.length_m,
                chain.start_s + chain.period_s * np.arange(len(chain.position_m)),
                chain.around,
                strict=True,
            )
        ]
        np.testing.assert_allclose(told[vehicle], ours, rtol=0.0, atol=1e-9)
        compared, lines = compared + 1, lines + int(np.isfinite(chain.around[:, 3]).sum())
    assert compared >= 5
    assert lines > 100


def chains_of(samples: TrackSamples, vehicle: int, length: int) -> list[list[int]]:
    """Numbers of the vehicles ahead of one in each sample in which it is in view."""
    chains = []
    for step in range(samples.steps):
        now = samples.at(step)
        if vehicle in now.vehicle:
            place = {number: k for k, number in enumerate(now.vehicle)}
            chains.append(Sample(0, step, now.leader, now.position_m, now.length_m, place).chain(vehicle, length))
    return chains


def test_a_report_shows_a_junction_and_several_lanes(recorded: Path, tmp_path: Path) -> None:
    told = CliRunner().invoke(app, ["report", str(recorded), "-o", str(tmp_path / "page.html")])
    assert told.exit_code == 0, told.output


def test_the_node_of_the_live_page_knows_who_lets_others_pass(stage, tracks: Tracks) -> None:
    about = [Parameter("rate", value=40.0), Parameter("wait_for", value=["/drivers"])]
    view, replay = View(0.0), Replay(TrackSamples(tracks), parameter_overrides=about)
    yielded: set[int] = set()
    stage.add(view, replay, DriversNode())

    def some_have_yielded() -> bool:
        yielded.update(view.yielding)
        return len(yielded) > 3

    stage.until(some_have_yielded)
    assert "ignored_yield" in view.effects


def test_a_recording_is_calibrated_as_its_tracks_are(tracks: Tracks, recorded: Path) -> None:
    of_recording = sg.calibrate(sg.read(recorded)).to_frame()[["v_star", "kappa_v"]]
    of_tracks = sg.calibrate(tracks).to_frame()[["v_star", "kappa_v"]]
    np.testing.assert_allclose(of_recording, of_tracks, rtol=1e-6)


def test_a_simulated_roundabout_is_followed_live(stage, tmp_path: Path) -> None:
    """Until the last vehicle has left; a driver is changed meanwhile."""
    about = {"scene": "roundabout", "vehicles": 12, "rate": 0.0, "wait_for": ["/drivers"], "exit_at_end": True}
    simulator = SimulatorNode(parameter_overrides=[Parameter(k, value=v) for k, v in about.items()])
    drivers = DriversNode()
    stage.add(simulator, drivers)
    assert stage.call(SetDriver, "/simulator/set_driver", SetDriver.Request(vehicle=11, name=["v_star"], value=[7.0]))
    stage.until(lambda: simulator.is_done, 60.0)
    assert simulator.samples.simulator.arrived.all()
    assert simulator.samples.collisions == 0
    learnt = [drivers.told[v].value["v_star"] for v in range(12)]
    expected = [*simulator.samples.simulator.drivers[:11, V_STAR], 7.0]
    np.testing.assert_allclose(learnt, expected, rtol=0.1)
