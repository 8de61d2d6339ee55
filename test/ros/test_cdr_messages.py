"""The most frequent messages, there and back."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes import source
from sugiyama_ros.nodes.base import cdr_messages, incoming
from sugiyama_ros.nodes.base.samples import Sample
from sugiyama_ros.nodes.source import Markers
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.placing import OPTIONAL, Positions


@pytest.mark.parametrize("known", [(), OPTIONAL, *((name,) for name in OPTIONAL), OPTIONAL[1:3]])
@pytest.mark.parametrize("vehicles", [0, 1, 2, 22])
def test_measured_positions_there_and_back(vehicles: int, known: tuple[str, ...]) -> None:
    rng = np.random.default_rng(vehicles)
    known = (*known, "arrive_s", "clear_s") if "line_m" in known else known
    given = {
        name: (rng.integers(0, 9, vehicles) if name == "lane" else rng.uniform(1.0, 2.0, vehicles)).tolist()
        for name in known
    }
    needed = [list(range(5, 5 + vehicles)), [-1] * vehicles, [1.0] * vehicles, [4.5] * vehicles]
    message = cdr_messages.measured_positions(-2 * cdr_messages.NS - 1, 2**40 + 3, Positions(*needed, **given))
    assert message.header.frame_id == FRAME
    sample = incoming.sample(bytes(serialize_message(message)))
    assert (sample.stamp_ns, sample.step) == (-2 * cdr_messages.NS - 1, 2**40 + 3)
    assert sample.place == {5 + k: k for k in range(vehicles)}
    assert [sample.leader, sample.position_m, sample.length_m] == needed[1:]
    assert {name: getattr(sample, name) for name in OPTIONAL} == {name: given.get(name, []) for name in OPTIONAL}


def test_a_chain_ends_where_there_is_no_leader_or_it_comes_back() -> None:
    sample = Sample(0, 0, [6, 7, -1, 8], [0.0] * 4, [0.0] * 4, {5: 0, 6: 1, 7: 2, 8: 3})
    assert sample.chain(5, 3) == [5, 6, 7]
    assert sample.chain(6, 3) == [6, 7, -1]
    assert sample.chain(7, 3) == [7, -1, -1]
    assert sample.chain(8, 3) == [8, -1, -1]


@pytest.mark.parametrize("ring_m", [0.0, 230.0])
@pytest.mark.parametrize("vehicles", [0, 1, 2, 3, 22])
def test_markers_are_boxes_where_the_vehicles_are(ring_m: float, vehicles: int) -> None:
    """Every number of every box, after rclpy has read the bytes; a vehicle without a position has no box."""
    number, length = [7 + 3 * k for k in range(vehicles)], [4.0 + 0.1 * k for k in range(vehicles)]
    position = [np.nan if k == 1 else 10.0 * k + 0.5 for k in range(vehicles)]
    raw = Markers(Road(ring_m)).message(
        12 * cdr_messages.NS + 345, Positions(number, [-1] * vehicles, position, length)
    )
    message = deserialize_message(raw, MarkerArray)
    assert len(bytes(serialize_message(message))) == pytest.approx(len(raw), abs=3)
    before = message.markers
    boxes = [m for m in before if m.ns == "vehicles"]
    assert before[0].action == Marker.DELETEALL
    assert [m.type for m in before if m.ns == "road"] == [Marker.LINE_STRIP] * (ring_m > 0.0)
    known = [k for k in range(vehicles) if k != 1]
    assert [m.id for m in boxes] == [number[k] for k in known]
    radius = ring_m / (2.0 * np.pi)
    for k, box in zip(known, boxes, strict=True):
        assert (box.type, box.action, box.header.frame_id) == (Marker.CUBE, Marker.ADD, FRAME)
        assert (box.scale.x, box.scale.y, box.scale.z) == (length[k], 1.7, 1.5)
        angle = position[k] / radius if radius else 0.0
        where = (radius * np.cos(angle), radius * np.sin(angle)) if radius else (position[k], 0.0)
        assert (box.pose.position.x, box.pose.position.y, box.pose.position.z) == pytest.approx((*where, 0.0))
        heading = angle + np.pi / 2.0 if radius else 0.0
        assert box.pose.orientation.z == pytest.approx(np.sin(heading / 2.0))
        assert box.pose.orientation.w == pytest.approx(np.cos(heading / 2.0))
    assert all((m.header.stamp.sec, m.header.stamp.nanosec) == (12, 345) for m in before)


def test_messages_of_markers_may_have_fewer_boxes_than_before_and_more() -> None:
    markers = Markers(Road(230.0))
    for vehicles in (3, 1, 0, 7, 6, 40, 2):
        number, position = [5 + k for k in range(vehicles)], [10.0 * k for k in range(vehicles)]
        raw = markers.message(vehicles, Positions(number, [-1] * vehicles, position, [4.0] * vehicles))
        first, line, *boxes = deserialize_message(raw, MarkerArray).markers
        assert (first.action, line.ns, len(line.points)) == (Marker.DELETEALL, "road", 73)
        assert [(m.id, m.ns, m.header.stamp.nanosec) for m in boxes] == [(k, "vehicles", vehicles) for k in number]


@pytest.mark.parametrize("byte", [0x1D, 0xC0, 0x07, 0x00, 0xFF])
def test_boxes_do_not_depend_on_what_the_middleware_leaves_between_the_fields(
    byte: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bytes between the fields have any value: the middleware does not set them."""
    filled = []

    def serialize(message: MarkerArray) -> bytes:
        raw = bytearray(serialize_message(message))
        known = deserialize_message(bytes(raw), MarkerArray)
        for place in range(4, len(raw)):
            changed = raw.copy()
            changed[place] ^= 0xFF
            try:
                if incoming.decoded(bytes(changed), MarkerArray) == known:
                    raw[place] = byte
                    filled.append(place)
            except incoming.RefusedError:
                pass
        return bytes(raw)

    monkeypatch.setattr(source, "serialize_message", serialize)
    number, position = [100, 7, 1], [10.5, 60.25, 90.0]
    raw = Markers(Road()).message(7, Positions(number, [-1] * 3, position, [4.0, 5.0, 6.0]))
    boxes = deserialize_message(raw, MarkerArray).markers[1:]
    assert len(filled) >= 10 * len(boxes)
    assert [m.id for m in boxes] == number
    assert [m.pose.position.x for m in boxes] == position
    assert [m.scale.x for m in boxes] == [4.0, 5.0, 6.0]
    assert [(m.header.stamp.sec, m.header.stamp.nanosec) for m in boxes] == [(0, 7)] * 3
