"""The parameter `adapt`: which parameters an estimator learns, and how they are published and kept."""

from pathlib import Path

import numpy as np
import pytest
from one_driver import OneDriver
from rclpy.node import Node
from rclpy.parameter import Parameter
from sugiyama_msgs.msg import DriverParameters
from sugiyama_msgs.srv import AddEffect

from sugiyama_ros.errors import InputError
from sugiyama_ros.nodes.base.qos import STREAM
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.keeper import file_of, kept_in, read_learnt
from sugiyama_ros.nodes.replay import Replay

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]


def test_an_added_effect_is_learnt_published_and_kept(stage, ring_csv: Path, tmp_path: Path) -> None:
    about = {"source": str(ring_csv), "ring": 100.0, "rate": 0.0, "wait_for": ["/drivers"]}
    replay = Replay(parameter_overrides=[Parameter(k, value=v) for k, v in about.items()])
    given = {"adapt": ["v_star", "kappa_v", "kappa_1", "effects"], "save_state": str(tmp_path)}
    estimator = OneDriver(0, **given)
    # as the service does, before the first sample
    request = AddEffect.Request(effect="drag", name=["c0"], value=[0.2])
    assert estimator._on_add_effect(request, AddEffect.Response()).success
    heard: list[DriverParameters] = []
    ears = Node("ears")
    ears.create_subscription(DriverParameters, "/vehicle_00/parameters", heard.append, STREAM)
    stage.add(replay, estimator, ears)
    stage.until(lambda: estimator.steps == 200)
    stage.until(lambda: heard[-1].header.stamp.sec == 99 and heard[-1].header.stamp.nanosec > 0)
    last = heard[-1]
    estimated = [name for name, is_estimated in zip(last.name, last.estimated, strict=True) if is_estimated]
    assert estimated == ["sigma_nu", "sigma_a", "v_star", "kappa_v", "kappa_1", "drag.c0", "drag.c2"]
    c0 = list(last.name).index("drag.c0")
    covariance = np.reshape(last.covariance, 2 * [len(last.name)])
    assert last.value[c0] != 0.2
    assert 0.0 < covariance[c0, c0] < 0.3**2
    assert covariance[c0, 2] != 0.0  # shared with v_star

    estimator.finish()
    kept, from_message = read_learnt(file_of(tmp_path, 0)), kept_in(last)
    assert kept.learnt.names == tuple(estimated)
    assert np.allclose(kept.learnt.mean, from_message.learnt.mean)
    assert np.allclose(kept.learnt.covariance, from_message.learnt.covariance)


@pytest.mark.parametrize(
    ("name", "message"), [("drag.weight", "cannot be learnt online"), ("omega_2", "adapted online")]
)
def test_what_cannot_be_learnt_is_refused_in_one_line(stage, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        DriversNode(parameter_overrides=[Parameter("adapt", value=[name])])
