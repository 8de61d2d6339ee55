"""Bags as others record them become the right tracks, or are refused with a cure that works."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from feeds import (
    CARS,
    DETECTIONS,
    LASTS_S,
    LENGTH_M,
    NO_STAMP,
    ODOMETRY,
    PX4,
    TRACKED,
    Recorded,
    Style,
    at,
    build,
    detections,
    every,
    folder,
    header,
    line,
    odometry,
    place,
    stamp,
    text_of,
    transforms,
    write,
)
from mcap.writer import CompressionType
from typer.testing import CliRunner

from sugiyama_ros.cli.app import app
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.trajectories.tracks import FREE, UNKNOWN, Tracks

pytestmark = pytest.mark.system
ODOM = "/car*/odom"


def sugiyama(*arguments: object) -> tuple[int, str]:
    """Exit code and what is printed; an error that a user can correct is code 2."""
    done = CliRunner().invoke(app, [str(one) for one in arguments])
    if isinstance(done.exception, InputError):
        return 2, str(done.exception)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.output


def document(*arguments: object) -> Any:
    """What a command prints with --json."""
    done = CliRunner().invoke(app, [*(str(one) for one in arguments), "--json"])
    assert done.exit_code == 0, done.exception
    return json.loads(done.stdout)


def converted(bag: Path, pattern: str = ODOM, *options: object) -> tuple[Tracks, str]:
    """Tracks of a bag, and what `convert` says."""
    out = bag.parent / "out.parquet"
    given = ("--odometry", pattern, "--centerline", line(bag.parent / "line.csv"), "--overwrite", *options)
    code, said = sugiyama("convert", bag, out, *given)
    assert code == 0, said
    return read_tracks(out), " ".join(said.split())


def refused(bag: Path, pattern: str = ODOM, *options: object) -> str:
    given = ("--odometry", pattern, "--centerline", line(bag.parent / "line.csv"), "--overwrite", *options)
    code, said = sugiyama("convert", bag, bag.parent / "out.parquet", *given)
    assert code == 2, said
    assert "\n" not in said.strip()
    return said


def leaders(tracks: Tracks) -> dict[int, dict[str, float]]:
    """Share of the rows of each vehicle by its leader: ``"0"``, ``"free"`` or ``"unknown"``."""
    found: dict[int, dict[str, float]] = {}
    for run in range(tracks.runs):
        rows = np.arange(tracks.start[run], tracks.start[run + 1])
        names = [
            {FREE: "free", UNKNOWN: "unknown"}.get(int(row)) or tracks.vehicle.at(int(row))
            for row in tracks.leader_row[rows]
        ]
        shares = {name: names.count(name) / len(names) for name in dict.fromkeys(names)}
        found[int(tracks.vehicle.at(int(rows[0])))] = shares
    return found


def check(tracks: Tracks, begin_s: float = 100.0, within_m: float = 0.02, unknown: float = 0.06) -> None:
    """Three cars, each behind the one before it, where they are in truth; nobody has a free road but the first."""
    shares = leaders(tracks)
    assert sorted(shares) == list(range(CARS)), shares
    assert shares[0].get("free", 0.0) > 1.0 - unknown
    for car in (1, 2):
        assert set(shares[car]) <= {str(car - 1), "unknown"}, shares
        assert shares[car][str(car - 1)] > 1.0 - unknown, shares
    for run in range(tracks.runs):
        rows = slice(tracks.start[run], tracks.start[run + 1])
        car = int(tracks.vehicle.at(tracks.start[run]))
        off_m = tracks.s_m[rows] - at(car, tracks.time_s[rows] - begin_s)
        assert np.abs(off_m).max() < within_m, (car, np.abs(off_m).max())


# --- rates, phases, holes


@pytest.mark.parametrize(
    ("periods", "phases", "usual_s"),
    [
        ((0.2, 0.1, 0.2), (0.03, 0.0, 0.11), 0.2),
        ((0.05, 0.1, 1.0 / 30.0), (0.0, 0.02, 0.05), 0.05),
        ((0.1, 0.4, 0.5), (0.0, 0.0, 0.3), 0.4),
    ],
)
def test_rates_and_phases(tmp_path: Path, periods: tuple, phases: tuple, usual_s: float) -> None:
    feeds = [odometry(car, every(periods[car], phases[car])) for car in range(CARS)]
    tracks, said = converted(write(tmp_path / "a.mcap", *feeds))
    check(tracks)
    assert np.median(np.diff(tracks.time_s[: tracks.start[1]])) == pytest.approx(usual_s, abs=1e-6)
    assert ("warning: vehicles were seen every" in said) == (max(periods) > 1.5 * min(periods))


def test_dropped_messages_jitter_and_another_period(tmp_path: Path) -> None:
    rng, feeds = np.random.default_rng(0), []
    for car in range(CARS):
        times = every(0.1, 0.03 * car)
        times = np.sort(times + rng.uniform(-0.03, 0.03, len(times)))
        feeds.append(odometry(car, times[rng.random(len(times)) > 0.3]))
    bag = write(tmp_path / "a.mcap", *feeds)
    check(converted(bag)[0], within_m=0.1, unknown=0.2)
    tracks, _ = converted(bag, ODOM, "--period", 0.2)
    check(tracks, within_m=0.1, unknown=0.2)


def test_a_vehicle_that_is_lost_is_not_gone(tmp_path: Path) -> None:
    """Car 1 is not seen for 8 s, begins late and ends early: car 2 never follows car 0, and never has a free road."""
    times = every(0.1)
    some = times[(times > 5.0) & ((times < 15.0) | (times > 23.0)) & (times < 33.0)]
    tracks, said = converted(write(tmp_path / "a.mcap", *(odometry(c, some if c == 1 else times) for c in range(CARS))))
    shares = leaders(tracks)
    assert shares[2] == {"1": pytest.approx(0.5, abs=0.01), "unknown": pytest.approx(0.5, abs=0.01)}
    assert shares[1] == {"0": 1.0}
    assert "1 times a vehicle was not seen" in said


# --- stamps


def seconds_only(t: float) -> dict[str, int]:
    return stamp(t) | {"nanosec": 0}


def never(_: float) -> dict[str, int]:
    return NO_STAMP


def always_the_same(_: float) -> dict[str, int]:
    return stamp(1.0)


def now_and_then(t: float) -> dict[str, int]:
    return NO_STAMP if round(t * 10) % 4 == 0 else stamp(t)


@pytest.mark.parametrize(
    ("stamps", "which"), [(never, (0, 1, 2)), (always_the_same, (1,)), (seconds_only, (0, 1, 2)), (now_and_then, (1,))]
)
def test_stamps_that_cannot_be_right(tmp_path: Path, stamps: Callable, which: tuple[int, ...]) -> None:
    feeds = [odometry(c, every(0.1), stamps if c in which else stamp) for c in range(CARS)]
    tracks, said = converted(write(tmp_path / "a.mcap", *feeds))
    check(tracks, within_m=0.15)  # the log times are 5 ms later
    for car in which:
        assert f"warning: /car{car}/odom: " in said
    assert "the log times count instead" in said
    assert len(tracks) > 1190


def test_clocks_that_are_apart(tmp_path: Path) -> None:
    feeds = [odometry(c, every(0.1), lambda t, c=c: stamp(t + 12.3 * (c == 1))) for c in range(CARS)]
    tracks, said = converted(write(tmp_path / "a.mcap", *feeds))
    check(tracks, within_m=0.02)
    assert "/car1/odom: its clock is 12.3 s ahead of the others; it was set by the log times" in said
    feeds = [odometry(c, every(0.1), lambda t, c=c: stamp(t - 0.4 * (c == 1))) for c in range(CARS)]
    bag = write(tmp_path / "a.mcap", *feeds)
    _, said = converted(bag)
    assert "/car1/odom: recorded 0.4 s later after its stamps than the others" in said
    bridge = tmp_path / "odometry.yaml"  # the cure
    assert "a bridge with `stamp: ''`" in said
    bridge.write_text(f"type: {ODOMETRY}\nx: pose.pose.position.x\ny: pose.pose.position.y\nstamp: ''\n")
    check(converted(bag, ODOM, "--bridge", bridge)[0], within_m=0.15)


def px4(car: int, unit_s: float, boot_s: float) -> list[Recorded]:
    """A car of PX4: a number as stamp, an array as position, a quaternion with w first."""

    def make(t: float) -> Callable[[Any], Any]:
        stamps, where = round((t + boot_s) / unit_s), [at(car, t), 0.0, 0.0]
        return lambda store: build(store, PX4, timestamp=stamps, position=where, q=[1.0, 0.0, 0.0, 0.0])

    return [Recorded(f"/px4_{car}/fmu/out/vehicle_odometry", PX4, t + 0.005, make(t)) for t in every(0.1).tolist()]


@pytest.mark.parametrize(("unit", "unit_s"), [("ms", 1e-3), ("ns", 1e-9)])
def test_stamps_in_other_units_and_quaternions_in_arrays(tmp_path: Path, unit: str, unit_s: float) -> None:
    bag = write(tmp_path / "a.mcap", *(px4(car, unit_s, 37.2) for car in range(CARS)))
    bridge, pattern = tmp_path / "px4.yaml", "/px4_*/fmu/out/vehicle_odometry"
    text = f"type: {PX4}\nx: position[0]\ny: position[1]\nstamp: timestamp\nframe: ''\n"
    bridge.write_text(text)
    said = refused(bag, pattern, "--bridge", bridge)
    cure = re.search(r"`(stamp_unit: \w+)`", said)
    assert cure, said
    bridge.write_text(text := text + cure[1] + "\n")
    assert cure[1] == f"stamp_unit: {unit}"
    tracks, _ = converted(bag, pattern, "--bridge", bridge)
    check(tracks, begin_s=37.2)
    bridge.write_text(text + "orientation: q\n")
    cure = re.search(r"`(orientation_order: \w+)`", refused(bag, pattern, "--bridge", bridge))
    assert cure
    bridge.write_text(f"{text}orientation: q\n{cure[1]}\n")
    check(converted(bag, pattern, "--bridge", bridge)[0], begin_s=37.2)
    bridge.write_text(text.replace("stamp: timestamp", "stamp: ''"))
    check(converted(bag, pattern, "--bridge", bridge)[0], within_m=0.15)


# --- names


@pytest.mark.parametrize("name_of", [lambda car: "", lambda car: "" if car == 1 else "7"])
def test_detections_that_cannot_be_told_apart(tmp_path: Path, name_of: Callable) -> None:
    said = refused(write(tmp_path / "a.mcap", detections(every(0.1), name_of)), "/det")
    assert "nobody can be followed; give the messages of a tracker" in said
    assert not (tmp_path / "out.parquet").exists()


@pytest.mark.parametrize("name_of", [lambda car: f"{car}.0", lambda car: f" track_{car} "])
def test_ids_that_begin_at_0(tmp_path: Path, name_of: Callable) -> None:
    tracks, _ = converted(write(tmp_path / "a.mcap", detections(every(0.1), name_of)), "/det")
    check(tracks)
    assert tracks.length_m[0] == pytest.approx(LENGTH_M)


def test_fields_of_another_version_are_named(tmp_path: Path) -> None:
    """Older detections have another field for the id."""
    text = text_of(DETECTIONS).replace(b"string id\n", b"string tracking_id\n")
    bag = write(tmp_path / "a.mcap", detections(every(0.1)), style=Style(definition=text))
    said = refused(bag, "/det")
    assert f"{DETECTIONS}: no field id, but header, results, bbox, tracking_id; give --bridge" in said
    bridge = tmp_path / "det.yaml"
    bridge.write_text(
        f"type: {DETECTIONS}\nobjects: detections\nid: tracking_id\n"
        "x: bbox.center.position.x\ny: bbox.center.position.y\nlength: bbox.size.x\n"
    )
    check(converted(bag, "/det", "--bridge", bridge)[0], unknown=0.001)


# --- order, files, compression


@pytest.mark.parametrize(
    ("order", "options"),
    [
        ("topic", {"chunk_size": 8192}),
        ("back", {"chunk_size": 8192, "use_summary_offsets": False, "use_statistics": False, "repeat_channels": False}),
        ("back", {"use_chunking": False}),
        ("topic", {"compression": CompressionType.LZ4, "index_types": 0}),
    ],
)
def test_order_in_the_file_does_not_matter(tmp_path: Path, order: str, options: dict[str, Any]) -> None:
    feeds = [odometry(car, every(0.1)) for car in range(CARS)]
    if "index_types" in options:
        from mcap.writer import IndexType

        options = options | {"index_types": IndexType.NONE}
    bag = write(tmp_path / "a.mcap", *feeds, style=Style(order, options=tuple(options.items())))
    tracks, _ = converted(bag)
    check(tracks, unknown=0.001)
    assert len(tracks) == 3 * 401


def test_directories_of_rosbag2(tmp_path: Path) -> None:
    """Files by topic or by time, compressed as a whole, unpacked beside, or with messages compressed one by one."""
    for number, packed in enumerate(("", ".zstd", ".zst")):
        files = {}
        for car in range(CARS):
            file = write(tmp_path / f"bag_{car}.mcap", odometry(car, every(0.1)))
            files[f"bag_{car}.mcap{packed}"] = file
        bag = folder(tmp_path / f"folder{number}", files, "FILE" if packed else "")
        check(converted(bag)[0], unknown=0.001)
        code, said = sugiyama("info", bag)
        assert code == 0
        assert "1203" in said
        assert all(f"/car{car}/odom" in said for car in range(CARS))
        assert len(document("echo", bag, "/car1/odom")) == 401
        if packed:
            beside = folder(tmp_path / f"beside{number}", dict.fromkeys(files), "FILE")
            for name, file in files.items():
                (beside / name.removesuffix(packed)).write_bytes(file.read_bytes())
            check(converted(beside)[0], unknown=0.001)
            one = next(iter(sorted(bag.glob(f"*{packed}"))))
            assert "401" in sugiyama("info", one)[1]
    feeds = [odometry(car, every(0.1)) for car in range(CARS)]
    bag = write(tmp_path / "a.mcap", *feeds, style=Style(packed=True, options=(("compression", CompressionType.NONE),)))
    check(converted(bag)[0], unknown=0.001)
    assert len(document("echo", bag, "/car0/odom")) == 401


def test_bags_of_another_storage(tmp_path: Path) -> None:
    """The cures for a database of rosbag2 and a bag of ROS 1 work as they are printed."""
    bag = write(tmp_path / "a.mcap", *(odometry(car, every(0.1)) for car in range(CARS)))
    convert = Path(sys.executable).parent / "rosbags-convert"
    source = folder(tmp_path / "source", {"a.mcap": bag})
    (source / "metadata.yaml").write_text(metadata_of(bag))
    for target in ("other", "ros1.bag"):
        made = subprocess.run([convert, "--src", source, "--dst", tmp_path / target], capture_output=True, check=False)
        assert made.returncode == 0, made.stderr
        said = refused(tmp_path / target)
        cure, then = re.search(r"run `(.*)`, and give (\S+)", said).groups()  # type: ignore[union-attr]
        done = subprocess.run([convert, *cure.split()[1:]], capture_output=True, check=False)
        assert done.returncode == 0, done.stderr
        check(converted(Path(then))[0], unknown=0.001)


def test_directories_that_were_indexed_again_or_have_no_metadata(tmp_path: Path) -> None:
    feeds = [odometry(car, every(0.1)) for car in range(CARS)]
    both = [[one for one in feed if (one.log_s < 20.0) == early] for early in (True, False) for feed in feeds]
    parts = {f"run_{k + 9}.mcap": write(tmp_path / f"{k}.mcap", *both[3 * k : 3 * k + 3]) for k in range(2)}
    bag = folder(tmp_path / "bag", dict(parts))
    meta = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(meta.replace("identifier: mcap", "identifier: ''"))
    check(converted(bag)[0], unknown=0.001)
    (bag / "metadata.yaml").unlink()
    check(converted(bag)[0], unknown=0.001)
    assert "1203" in sugiyama("info", bag)[1]
    (bag / "run_9.mcap").rename(bag / "other.mcap")
    assert "its names do not say that its files are one bag; give one file" in refused(bag)
    (bag / "metadata.yaml").write_text(meta.replace("identifier: mcap", "identifier: ''").replace(".mcap", ".db3"))
    assert "write `storage_identifier: sqlite3` into metadata.yaml, run `rosbags-convert --src" in refused(bag)


def metadata_of(bag: Path) -> str:
    topics = "".join(
        f"    - topic_metadata: {{name: /car{car}/odom, type: {ODOMETRY}, serialization_format: cdr,"
        " offered_qos_profiles: '', type_description_hash: ''}\n      message_count: 401\n"
        for car in range(CARS)
    )
    return (
        "rosbag2_bagfile_information:\n  version: 6\n  storage_identifier: mcap\n"
        "  duration: {nanoseconds: 40000000000}\n"
        "  starting_time: {nanoseconds_since_epoch: 100005000000}\n  message_count: 1203\n"
        f"  topics_with_message_count:\n{topics}  compression_format: ''\n  compression_mode: ''\n"
        f"  relative_file_paths: [{bag.name}]\n  files:\n    - path: {bag.name}\n"
        "      starting_time: {nanoseconds_since_epoch: 100005000000}\n      duration: {nanoseconds: 40000000000}\n"
        "      message_count: 1203\n"
    )


# --- definitions


def idl_of(kind: str, share: Path) -> str:
    """The definition as rosbag2 writes it in IDL, from the files that are installed."""
    names, texts = [kind], {}
    while names:
        name = names.pop(0)
        texts[name] = (share / f"{name}.idl").read_text()
        names += [f for f in re.findall(r'#include "(.*)\.idl"', texts[name]) if f not in texts and f not in names]
    return "".join(f"{'=' * 80}\nIDL: {name}\n{text}" for name, text in texts.items())


def test_definitions_of_other_kinds(tmp_path: Path) -> None:
    feeds = [odometry(car, every(0.1)) for car in range(CARS)]
    share = Path(sys.prefix) / "share"
    styles = [Style(definition=b""), Style(encoding="ros1msg"), Style(encoding="ros1msg", definition=b"")]
    styles += [Style(encoding="", definition=b""), Style(encoding="ros2idl", definition=b"no IDL at all")]
    if (share / "nav_msgs/msg/Odometry.idl").exists():
        styles.append(Style(encoding="ros2idl", definition=idl_of(ODOMETRY, share).encode()))
    for style in styles:
        bag = write(tmp_path / "a.mcap", *feeds, style=style)
        check(converted(bag)[0], unknown=0.001)
        assert len(document("echo", bag, "/car1/odom")) == 401


# --- frames


def ego(t: float) -> tuple[float, float, float]:
    """The car that sees the others drives 30 m behind the last one, on the next lane, and turns a little."""
    return float(at(2, t)) - 30.0, -3.5, 0.2 * np.sin(0.5 * t)


def from_ego(car: int, t: float, pose: Callable = ego) -> dict[str, Any]:
    x, y, yaw = pose(t)
    dx, dy = float(at(car, t)) - x, -y
    return place(np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx, -yaw)


@pytest.mark.parametrize(("late_s", "times"), [(0.002, every(0.02, -0.01)), (0.3, every(0.1, -0.0371))])
def test_transforms_are_interpolated(tmp_path: Path, times: Any, late_s: float) -> None:
    """Also where a sensor's place is told late and once, and the transforms are recorded later than what was seen."""
    sensor = transforms(np.array([5.0]), lambda _: (0.0, 0.0, 0.0), "base_link", "radar", topic="/tf_static")
    feeds = [detections(every(0.1), seen=from_ego, frame="radar"), transforms(times, ego, late_s=late_s), sensor]
    bag = write(tmp_path / "a.mcap", *feeds)
    tracks, _ = converted(bag, "/det", "--frame", "map")
    check(tracks, within_m=0.03)
    assert len(tracks) > 1190
    bag = write(tmp_path / "b.mcap", feeds[0], transforms(times, ego, child="radar"))
    assert "radar, which moves; give --frame, the frame of the centre line" in refused(bag, "/det")


def test_positions_in_frames_of_their_own(tmp_path: Path) -> None:
    """Each car counts from its own start; only --frame with transforms, or a bridge, puts them together."""
    feeds = [odometry(car, every(0.1), frame=f"car{car}/odom") for car in range(CARS)]
    said = refused(write(tmp_path / "a.mcap", *feeds))
    assert "positions are in several frames (car0/odom, car1/odom, car2/odom); give --frame" in said
    bridge = tmp_path / "odometry.yaml"
    bridge.write_text(f"type: {ODOMETRY}\nx: pose.pose.position.x\ny: pose.pose.position.y\nframe: ''\n")
    check(converted(tmp_path / "a.mcap", ODOM, "--bridge", bridge)[0], unknown=0.001)
    bridge.write_text(bridge.read_text() + "vehicle_class: header.frame_id\n")
    tracks, _ = converted(tmp_path / "a.mcap", ODOM, "--bridge", bridge)
    assert tracks.vehicle_class is not None
    assert tracks.vehicle_class.used() == tuple(f"car{car}/odom" for car in range(CARS))
    fixed = [transforms(every(1.0), lambda _: (0.0, 0.0, 0.0), child=f"car{car}/odom") for car in range(CARS)]
    check(converted(write(tmp_path / "a.mcap", *feeds, *fixed), ODOM, "--frame", "map")[0])
    said = refused(write(tmp_path / "b.mcap", *feeds), ODOM, "--frame", "map")
    assert "no transform leads from car0/odom, car1/odom, car2/odom to map" in said


# --- headings


@pytest.mark.parametrize(("availability", "turned"), [(2, 0.0), (1, np.pi), (0, 1.3)])
def test_headings_of_which_the_sign_is_unknown(tmp_path: Path, availability: int, turned: float) -> None:
    """Car 3 comes the other way, on the same lane as the map shows it."""

    def make(t: float) -> Callable[[Any], Any]:
        objects = [
            {
                "object_id": {"uuid": np.full(16, car + 1, dtype=np.uint8)},
                "kinematics": {
                    "pose_with_covariance": {"pose": place(at(car, t), 0.0, turned)},
                    "orientation_availability": availability,
                },
                "shape": {"dimensions": {"x": LENGTH_M, "y": 2.0, "z": 1.5}},
            }
            for car in range(CARS)
        ]
        other = {
            "object_id": {"uuid": np.full(16, 99, dtype=np.uint8)},
            "kinematics": {
                "pose_with_covariance": {"pose": place(1500.0 - 20.0 * t, 0.0, np.pi + turned)},
                "orientation_availability": availability,
            },
        }
        return lambda store: build(store, TRACKED, header=header(t), objects=[*objects, other])

    feed = [Recorded("/objects", TRACKED, t, make(t)) for t in every(0.1).tolist()]
    tracks, said = converted(write(tmp_path / "a.mcap", feed), "/objects")
    assert tracks.runs == CARS, said
    assert re.search(r"beside the road 401", said)
    assert sorted(float(tracks.s_m[k]) for k in tracks.start[:-1]) == pytest.approx([at(2, 0), at(1, 0), at(0, 0)])


# --- classes


@pytest.mark.parametrize("kind", ["Pedestrian", "barrier"])
def test_who_drives_nothing_is_no_vehicle(tmp_path: Path, kind: str) -> None:
    """The second of three detections is no vehicle: whoever is behind it has an unknown leader."""
    feed = detections(every(0.1), kind_of=lambda car: "car" if car != 1 else kind)
    tracks, said = converted(write(tmp_path / "d.mcap", feed), "/det")
    assert tracks.vehicle.used() == ("0", "2")
    assert f"left out: 1 {kind.lower()}" in said
    assert leaders(tracks)[2] == {"unknown": 1.0}
    assert tracks.vehicle_class is not None
    assert tracks.vehicle_class.used() == ("car",)


# --- all at once


def any_feed(rng: np.random.Generator) -> tuple[list[list[Recorded]], str, tuple[str, ...], float]:
    """Feeds of three cars at random, their pattern, options, and the share of rows that may be lost."""
    drop = float(rng.choice([0.0, 0.1, 0.3]))
    period = rng.choice([0.02, 0.05, 0.1, 0.2, 0.25], CARS if rng.random() < 0.5 else 1)
    jitter = float(rng.choice([0.0, 0.1]))
    kind = rng.choice(["odometry", "detections", "ego"])
    late = float(rng.choice([0.0, 0.004, 0.08]))

    def times(k: int) -> Any:
        own_s = float(period[k % len(period)])
        found = every(own_s, rng.uniform(0.0, own_s))
        found = found + rng.uniform(-jitter, jitter, len(found)) * own_s
        return found[rng.random(len(found)) >= drop]

    if kind == "odometry":
        stamps = rng.choice([stamp, never], CARS) if jitter == 0.0 and drop == 0.0 else [stamp] * CARS
        return [odometry(c, times(c), stamps[c], late) for c in range(CARS)], ODOM, (), drop
    if kind == "detections":
        return [detections(times(0))], "/det", (), drop
    feeds = [detections(times(0), seen=from_ego, frame="base_link")]
    own_s = float(rng.choice([0.02, 0.1]))
    feeds.append(transforms(every(own_s, -rng.uniform(0.0, own_s), LASTS_S + 1.0), ego, late_s=late))
    return feeds, "/det", ("--frame", "map"), drop


@pytest.mark.parametrize("seed", range(3))
def test_any_mixture(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    feeds, pattern, options, drop = any_feed(rng)
    style = Style(order=str(rng.choice(["log", "topic", "back"])), packed=bool(rng.random() < 0.3))
    tracks, _ = converted(write(tmp_path / "a.mcap", *feeds, style=style), pattern, *options)
    # the log times that count instead of stamps may be late by 0.08 s
    check(tracks, within_m=0.15 if pattern == "/det" or drop else 2.0, unknown=0.5 if drop else 0.05)


def test_a_directory_with_road_and_measured_is_a_recording(tmp_path: Path) -> None:
    """Our own topics in a directory of rosbag2, also compressed, are read by every command that takes a file."""
    given = ("--vehicles", 4, "--ring", 60, "--duration", 20, "--seed", 1)
    assert sugiyama("simulate", *given, "-o", tmp_path / "ring.mcap")[0] == 0
    one = document("calibrate", tmp_path / "ring.mcap")
    for name in ("ring_0.mcap", "ring_0.mcap.zstd"):
        bag = folder(tmp_path / f"of_{name[5:]}", {name: tmp_path / "ring.mcap"}, "FILE" if name.endswith("d") else "")
        assert document("calibrate", bag)["log_likelihood"] == one["log_likelihood"]
        assert document("info", bag / name)["messages"] == document("info", tmp_path / "ring.mcap")["messages"]
    code, said = sugiyama("recover", bag / name, "-o", tmp_path / "again.mcap")
    assert (code, "0 bytes lost" in said) == (0, True)
    bag = write(tmp_path / "a.mcap", odometry(0, every(0.1)))
    code, said = sugiyama("calibrate", bag)
    assert (code, "with --odometry" in said) == (2, True)
