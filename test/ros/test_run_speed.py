"""The measurement of the speed of a run measures what it says. How fast the machine is does not matter here."""

import pytest

from benchmarks.speed.graph import empty, loop
from benchmarks.speed.run import KINDS, measure
from benchmarks.speed.timing import jam
from sugiyama_ros.formats.mcap_reader import Bag

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]


@pytest.mark.slow
def test_a_run_and_its_floors_are_measured() -> None:
    found = measure(jam(duration_s=60.0), rounds=1)
    assert set(found) == set(KINDS)
    for times in found.values():
        assert all(value > 0.0 for value in times.values())
        assert times["floors_s"] == pytest.approx(times["graph_s"] + times["filters_s"] + times["writing_s"])
        assert times["loop_over_floors"] == pytest.approx(times["loop_s"] / times["floors_s"])
        assert times["process_s"] > times["loop_s"]
    # 1 message a step against 44 of them
    assert found["one_message"]["graph_s"] < found["topics_of_each_vehicle"]["graph_s"]


def test_the_empty_graph_sends_every_message_of_a_bag(road_csv, tmp_path) -> None:
    bag = tmp_path / "run.mcap"
    assert loop(road_csv, bag, array=False) > 0.0
    with Bag(bag) as opened:
        assert opened.info().messages > 2000
    # it raises an error unless every message has come
    assert empty(bag) > 0.0
