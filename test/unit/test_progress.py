"""Whoever waits is told how far the work is: on a terminal by a bar, elsewhere by a line a minute."""

import sys
import threading
import time
from types import SimpleNamespace

import pytest

from sugiyama_ros import progress


def next_line(capsys: "pytest.CaptureFixture[str]") -> str:
    """The last line on stderr, as soon as there is one."""
    until = time.monotonic() + 60.0
    while not (told := capsys.readouterr().err):
        assert time.monotonic() < until
        time.sleep(0.01)
    return told.splitlines()[-1]


def test_the_first_minute_is_silent_in_a_pipe(capsys: "pytest.CaptureFixture[str]") -> None:
    assert progress._LINES_EVERY_S == 60.0
    with progress.stages() as advance:
        advance("scoring", 0, 3)
    with progress.stage("simulating"):
        pass
    assert capsys.readouterr() == ("", "")


def test_long_work_tells_in_a_pipe_how_far_it_is(
    capsys: "pytest.CaptureFixture[str]", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_LINES_EVERY_S", 0.02)
    threads = threading.active_count()
    with progress.stages() as advance:
        assert next_line(capsys) == "starting; 0 min"
        advance("round 1: fitting", 2, 7)
        capsys.readouterr()
        # a stage that lasts is told more than once
        assert [next_line(capsys) for _ in range(2)][1] == "round 1: fitting, 2 of 7; 0 min"
        in_an_hour = SimpleNamespace(monotonic=lambda: time.monotonic() + 3600.0)
        monkeypatch.setattr(progress, "time", in_an_hour)
        advance("checking the final model", 0, 1)
        capsys.readouterr()
        assert [next_line(capsys) for _ in range(2)][1] == "checking the final model; 60 min"
    assert threading.active_count() == threads
    capsys.readouterr()
    time.sleep(0.1)
    assert capsys.readouterr() == ("", "")


def test_work_ends_well_though_it_fails_or_nobody_reads(
    capsys: "pytest.CaptureFixture[str]", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_LINES_EVERY_S", 0.01)
    threads = threading.active_count()

    def interrupted() -> None:
        with progress.stage("simulating"):
            assert next_line(capsys) == "simulating; 0 min"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert threading.active_count() == threads

    class Closed:
        told = 0

        def write(self, text: str) -> None:
            self.told += 1
            raise BrokenPipeError

    closed = Closed()
    monkeypatch.setattr(sys, "stderr", closed)
    with progress.stage("simulating"):
        while closed.told < 2:
            time.sleep(0.01)
    assert threading.active_count() == threads
