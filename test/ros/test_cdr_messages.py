"""The bytes of this package's encoders equal the bytes of rclpy."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sugiyama_msgs.msg import DriverParameters, Innovation, MeasuredPositions, VehicleState
from visualization_msgs.msg import Marker, MarkerArray

from sugiyama_ros.filters.online import Estimate
from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.samples import Sample
from sugiyama_ros.nodes.source import Markers
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.placing import Positions


def an_estimate(seed: int) -> Estimate:
    """An estimate with arbitrary numbers."""
    rng = np.random.default_rng(seed)
    n = iter(rng.normal(size=20).tolist())
    return Estimate(
        position_m=next(n),
        speed=next(n),
        acceleration=next(n),
        covariance=rng.normal(size=(3, 3)),
        mean_action=next(n),
        gap_m=float("inf"),
        approach_rate=next(n),
        innovation_m=next(n),
        innovation_var=next(n),
        nis=next(n),
        log_likelihood=next(n),
        scored=bool(seed % 2),
    )


@pytest.mark.parametrize("frame", ["", "a", "road", "a longer name"])
@pytest.mark.parametrize("vehicles", [0, 1, 2, 3, 22])
def test_measured_positions_are_read(frame: str, vehicles: int) -> None:
    rng = np.random.default_rng(vehicles)
    message = MeasuredPositions(step=2**40 + 3, vehicle=list(range(5, 5 + vehicles)))
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = -3, 999_999_999
    message.leader = rng.integers(-1, 1000, vehicles).tolist()
    message.position_m = rng.normal(size=vehicles).tolist()
    message.length_m = rng.normal(size=vehicles).tolist()
    sample = cdr_messages.measured(serialize_message(message))
    assert sample.stamp_ns == -3 * cdr_messages.NS + 999_999_999
    assert sample.step == message.step
    assert list(sample.place) == message.vehicle.tolist()
    assert list(sample.place.values()) == list(range(vehicles))
    assert sample.leader == message.leader.tolist()
    assert sample.position_m == message.position_m.tolist()
    assert sample.length_m == message.length_m.tolist()


OPTIONAL = ("lane", "d_m", "stamp_offset_s", "position_var")


@pytest.mark.parametrize("known", [(), OPTIONAL, *((name,) for name in OPTIONAL), OPTIONAL[1:3]])
@pytest.mark.parametrize("vehicles", [1, 2, 3])
def test_optional_fields_are_written_and_read(vehicles: int, known: tuple[str, ...]) -> None:
    rng = np.random.default_rng(vehicles)
    given = {
        name: (rng.integers(0, 9, vehicles) if name == "lane" else rng.normal(size=vehicles)).tolist() for name in known
    }
    needed = [list(range(vehicles)), [-1] * vehicles, [1.0] * vehicles, [4.5] * vehicles]
    raw = cdr_messages.measured_positions(5, 7, Positions(*needed, **given))
    message = deserialize_message(raw, MeasuredPositions)
    for sample in (cdr_messages.measured(raw), cdr_messages.measured(serialize_message(message))):
        for name in OPTIONAL:
            assert list(getattr(sample, name)) == getattr(message, name).tolist() == given.get(name, [])


@pytest.mark.parametrize("vehicles", [0, 1, 2, 3])
@pytest.mark.parametrize("padding", [0, 1, 3])
def test_messages_of_the_older_definition_are_read(vehicles: int, padding: int) -> None:
    needed = Positions(list(range(vehicles)), [-1] * vehicles, [1.0] * vehicles, [4.5] * vehicles)
    raw = cdr_messages.measured_positions(5, 7, needed)
    assert cdr_messages.measured(raw[:-16] + bytes(padding))[:6] == cdr_messages.measured(raw)[:6]
    assert cdr_messages.measured(raw[:-16]).lane == ()


@pytest.mark.parametrize("vehicles", [0, 1, 2, 22])
def test_measured_positions_are_written(vehicles: int) -> None:
    rng = np.random.default_rng(vehicles)
    positions = Positions(
        rng.integers(0, 1000, vehicles).tolist(),
        rng.integers(-1, 1000, vehicles).tolist(),
        [float("nan"), *rng.normal(size=vehicles).tolist()][:vehicles],
        rng.normal(size=vehicles).tolist(),
    )
    raw = cdr_messages.measured_positions(7 * cdr_messages.NS + 5, 2**40 + 3, positions)
    expected = MeasuredPositions(step=2**40 + 3, **positions._asdict())
    expected.header.stamp, expected.header.frame_id = cdr_messages.time_message(7 * cdr_messages.NS + 5), FRAME
    # NaN differs from itself, and bytes between the fields are arbitrary, so the texts are compared.
    assert repr(deserialize_message(raw, MeasuredPositions)) == repr(expected)
    assert cdr_messages.measured(raw).stamp_ns == 7 * cdr_messages.NS + 5
    assert cdr_messages.stamp_key(raw) == cdr_messages.stamp_key(serialize_message(expected))


@pytest.mark.parametrize("stamp_ns", [0, 250 * cdr_messages.NS + 999_999_999, -1])
def test_clocks_are_written(stamp_ns: int) -> None:
    assert cdr_messages.clock(stamp_ns) == serialize_message(Clock(clock=cdr_messages.time_message(stamp_ns)))


def test_another_byte_order_is_refused() -> None:
    raw = bytearray(serialize_message(MeasuredPositions()))
    raw[1] = 0
    with pytest.raises(ValueError, match="CDR format 0"):
        cdr_messages.measured(bytes(raw))


@pytest.mark.parametrize("stamp_ns", [0, 1, 333_333_333, 250 * cdr_messages.NS + 999_999_999, -1])
def test_states_are_written(stamp_ns: int) -> None:
    estimate = an_estimate(1)
    expected = VehicleState(vehicle=7, covariance=estimate.covariance.ravel())
    expected.header.stamp, expected.header.frame_id = cdr_messages.time_message(stamp_ns), FRAME
    for name in ("position_m", "speed", "acceleration", "mean_action", "gap_m", "approach_rate"):
        setattr(expected, name, getattr(estimate, name))
    raw = cdr_messages.state(stamp_ns, 7, estimate)
    assert len(raw) == len(serialize_message(expected))
    # Bytes between the fields are arbitrary, so the messages are compared, not the bytes.
    assert deserialize_message(raw, VehicleState) == expected
    assert cdr_messages.stamp_key(raw) == cdr_messages.stamp_key(serialize_message(expected))


@pytest.mark.parametrize("seed", [0, 1])
def test_innovations_are_written(seed: int) -> None:
    estimate = an_estimate(seed)
    expected = Innovation(vehicle=-1)
    expected.header.stamp, expected.header.frame_id = cdr_messages.time_message(5), FRAME
    for name in ("innovation_m", "innovation_var", "nis", "log_likelihood", "scored"):
        setattr(expected, name, getattr(estimate, name))
    raw = cdr_messages.innovation(5, -1, estimate)
    assert len(raw) == len(serialize_message(expected))
    assert deserialize_message(raw, Innovation) == expected


def test_many_innovations_are_read_at_once_and_those_of_others_passed_over() -> None:
    estimates = [an_estimate(seed) for seed in range(3)]
    good = [cdr_messages.innovation(5, vehicle, e) for vehicle, e in enumerate(estimates)]
    other_frame = good[0].replace(FRAME.encode(), b"x" * len(FRAME))
    big_endian = b"\0\0" + good[0][2:]
    found = cdr_messages.read_innovations(
        [good[0], other_frame, b"", good[1][:-1], big_endian, good[1] + b"\0", good[2]]
    )
    assert found["vehicle"].tolist() == [0, 1, 2]
    for name in ("innovation_m", "nis", "scored"):
        assert found[name].tolist() == [getattr(e, name) for e in estimates]
    assert len(cdr_messages.read_innovations([])) == 0


def test_a_chain_ends_where_there_is_no_leader_or_it_comes_back() -> None:
    sample = Sample(0, 0, [6, 7, -1, 8], [0.0] * 4, [0.0] * 4, {5: 0, 6: 1, 7: 2, 8: 3})
    assert sample.chain(5, 3) == [5, 6, 7]
    assert sample.chain(6, 3) == [6, 7, -1]
    assert sample.chain(7, 3) == [7, -1, -1]
    assert sample.chain(8, 3) == [8, -1, -1]


@pytest.mark.parametrize("count", [12, 13])
@pytest.mark.parametrize("stamp_ns", [0, 250 * cdr_messages.NS + 999_999_999])
def test_parameters_are_written(stamp_ns: int, count: int) -> None:
    rng = np.random.default_rng(3)
    value, covariance = rng.normal(size=count), rng.normal(size=(count, count))
    identified = np.arange(count) % 3 == 0
    names = [f"a_name_{k}" for k in range(count)]
    writer = cdr_messages.ParametersWriter(7, names, names[2:4])
    for _ in range(2):
        message = deserialize_message(writer.message(stamp_ns, value, covariance, identified), DriverParameters)
    assert message.header.stamp.sec * cdr_messages.NS + message.header.stamp.nanosec == stamp_ns
    assert (message.header.frame_id, message.vehicle, message.name) == ("road", 7, names)
    assert message.estimated == [k in (2, 3) for k in range(count)]
    assert message.identified == identified.tolist()
    assert message.value.tolist() == value.tolist()
    assert message.covariance.tolist() == covariance.ravel().tolist()


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
