"""Pacing and levels, without ROS."""

import pytest

from sugiyama_ros.nodes.recorder import Levels
from sugiyama_ros.nodes.source import Pace


def send_all(pace: Pace) -> int:
    """Send as many steps as allowed, and return their number."""
    count = 0
    while pace.may_send and count < 1000:
        pace.sent()
        count += 1
    return count


def test_nothing_is_sent_before_all_subscribers_are_there() -> None:
    pace = Pace(8, 10.0, ["/a", "/b"])
    pace.heard("/a", 0, 0.0)
    assert send_all(pace) == 0
    pace.heard("/b", 0, 0.0)
    assert send_all(pace) == 8


def test_the_slowest_subscriber_decides() -> None:
    pace = Pace(8, 10.0, ["/a", "/b"])
    pace.heard("/a", 0, 0.0)
    pace.heard("/b", 0, 0.0)
    send_all(pace)
    pace.heard("/a", 8, 0.0)
    assert send_all(pace) == 0
    pace.heard("/b", 3, 0.0)
    assert send_all(pace) == 3
    assert pace.acknowledged == 3
    assert not pace.drained


def test_silent_subscribers_are_dropped_and_may_come_back() -> None:
    pace = Pace(8, 10.0)
    pace.heard("/a", 0, 0.0)
    pace.heard("/b", 0, 0.0)
    assert send_all(pace) == 8
    pace.heard("/a", 8, 9.0)
    assert pace.drop_silent(10.0) == []
    assert pace.drop_silent(10.1) == ["/b"]
    assert pace.dropped == {"/b"}
    assert send_all(pace) == 8
    pace.heard("/b", 8, 11.0)
    assert pace.dropped == set()
    assert pace.acknowledged == 8


def test_a_newcomer_holds_the_source_until_it_has_caught_up() -> None:
    pace = Pace(8, 10.0)
    for _ in range(100):
        pace.sent()
    pace.heard("/late", 0, 0.0)
    assert not pace.may_send
    pace.heard("/late", 100, 0.0)
    assert send_all(pace) == 8


def test_a_restart_forgets_earlier_reports() -> None:
    pace = Pace(8, 10.0)
    pace.heard("/a", 0, 0.0)
    assert send_all(pace) == 8
    pace.heard("/a", 8, 0.0)
    assert pace.drained
    pace.restart(2)
    pace.heard("/a", 8, 0.1)  # a repetition of a report from before the restart
    assert pace.acknowledged == 2
    assert send_all(pace) == 8
    # Step 10 has been sent, so an old report of 8 is taken for a new one: at most one window too far.
    pace.heard("/a", 8, 0.2)
    assert send_all(pace) <= 8


def test_levels_are_complete_when_all_topics_are() -> None:
    levels = Levels(["/x", "/y"])
    assert not levels.reached("/x", b"1")
    assert not levels.reached("/x", b"2")
    assert levels.waiting
    assert levels.reached("/y", b"1")
    assert levels.reached("/y", b"2")
    assert not levels.waiting


@pytest.mark.parametrize("steps", [1, 5])
def test_a_late_topic_is_dropped(steps: int) -> None:
    levels = Levels(["/x", "/y", "/late"])
    stamps = [bytes([k]) for k in range(steps)]
    for stamp in stamps:
        assert not levels.reached("/x", stamp)
        assert not levels.reached("/y", stamp)
    assert levels.drop_late() == (["/late"], stamps[-1])
    assert not levels.reached("/x", b"n")
    assert levels.reached("/y", b"n")
