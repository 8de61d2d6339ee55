"""Calibration on tracks: the same model as on a ring, for vehicles that come and go."""

from dataclasses import replace

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.calibration.on_tracks import calibrate_tracks
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import V_STAR
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.labels import labels_of
from sugiyama_ros.trajectories.stretches import SHORTEST_STRETCH_S


@pytest.fixture(scope="module")
def recording():
    return sg.simulate(vehicles=5, ring_m=56.0, duration_s=90.0, seed=2)


@pytest.fixture(scope="module")
def tracks(recording):
    return recording.measured


def test_drivers_on_a_ring_are_the_same_on_tracks(recording, tracks):
    on_tracks, dense = calibrate_tracks(tracks), sg.calibrate(recording.measured)
    assert [d.vehicle for d in on_tracks.drivers] == [str(v) for v in recording.dense.vehicle]
    assert on_tracks.settings.estimated == dense.settings.estimated
    for k, driver in enumerate(on_tracks.drivers):
        # the dense calibration knows the drivers ahead from a first pass, which moves v* by a part of its error
        error = max(dense.std[k]["v_star"], 0.1)
        assert abs(on_tracks.rows[k, V_STAR] - dense.rows[k, V_STAR]) < error
        assert driver.nis == pytest.approx(1.0, abs=0.35)  # 270 samples know it to 9 %


def test_drivers_who_follow_for_a_short_time_are_left_out(tracks):
    leaves = np.asarray(tracks.time_s) < tracks.time_s[0] + SHORTEST_STRETCH_S - 0.5
    stays = np.asarray(tracks.run) != 1
    found = calibrate_tracks(tracks.select(stays | leaves))
    # one vehicle leaves, and its follower follows somebody who is not known from then on
    assert [d.vehicle for d in found.drivers] == ["2", "3", "4"]
    assert len(found.table().rows) == 3 + 1
    with pytest.raises(
        InputError,
        match=r"nobody is seen for more than 4\.33 s, but .* for 5 s; give longer",
    ):
        calibrate_tracks(tracks.select(leaves))
    alone = np.asarray(tracks.run) == 1
    with pytest.raises(InputError, match="nobody follows a known vehicle for 5 s"):
        calibrate_tracks(tracks.select(alone))


def test_classes_are_told_apart_by_their_leaders(tracks):
    kind = np.where(np.asarray(tracks.run) % 2 == 0, "truck", "car")
    found = calibrate_tracks(replace(tracks, vehicle_class=labels_of(kind.tolist())), Settings(estimated=("v_star",)))
    assert [one.shown for one in found.vehicle_classes] == ["car", "truck"]
    # five vehicles on a ring: vehicle 4 follows vehicle 0, and both are trucks
    assert [(one.shown, one.drivers) for one in found.pairs] == [
        ("car behind truck", 2),
        ("truck behind car", 2),
        ("truck behind truck", 1),
    ]
    assert [one["leader_class"] for one in found.document(0.0)["class_pairs"]] == ["truck", "car", "truck"]
    assert [row[1] for row in found.table().rows[5:]] == ["car", "truck", *(one.shown for one in found.pairs)]
