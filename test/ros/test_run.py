"""The main job from end to end: nothing is lost, and nothing hangs."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from sugiyama_ros.cli.app import app
from sugiyama_ros.driver.parameters import V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError, OutputError, SugiyamaError
from sugiyama_ros.fit.model_file import FittedDrivers, write_drivers
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.reading import checksum_of
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.formats.truth import read_truth
from sugiyama_ros.nodes import recorder, source
from sugiyama_ros.nodes.base.node import PacedNode
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.follower import Follower
from sugiyama_ros.nodes.plan import FromSimulator
from sugiyama_ros.nodes.run import RunResult, run
from sugiyama_ros.page.words import start_of_drivers
from sugiyama_ros.simulation.experiment import Experiment

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]


def assert_nothing_lost(result: RunResult, output: Path) -> None:
    """All 200 steps of 4 vehicles are in the file, on every topic."""
    assert (result.steps, result.vehicles, result.messages_lost, result.interrupted) == (200, 4, 0, False)
    assert result.messages_published == result.messages_recorded
    with Bag(output) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
        # the log times are those of the data, also of what comes long after a burst of samples
        stamps = [
            (m.log_time_ns, m.message.header.stamp.sec * 10**9 + m.message.header.stamp.nanosec)
            for m in bag.messages([f"/vehicle_0{v}/{topic}" for v in range(4) for topic in ("state", "parameters")])
        ]
    assert all(log_ns == stamp_ns for log_ns, stamp_ns in stamps)
    per_step = {"/clock", "/measured"} | {f"/vehicle_0{v}/{t}" for v in range(4) for t in ("state", "innovation")}
    assert {name: counts[name] for name in per_step} == dict.fromkeys(per_step, 200)
    assert counts["/road"] == 1
    assert all(counts[f"/vehicle_0{v}/parameters"] >= 100 for v in range(4))
    assert set(counts) == per_step | {"/road", "/markers", "/diagnostics", "/rosout"} | {
        f"/vehicle_0{v}/{topic}" for v in range(4) for topic in ("parameters", "style_change")
    }


def test_the_recorded_positions_equal_the_positions_read(recorded: tuple[Path, RunResult]) -> None:
    source, result = recorded
    assert_nothing_lost(result, result.output)
    original, back = read_tracks(source, Choices(ring_m=100.0)).dense(), read_tracks(result.output).dense()
    assert back.position_m == pytest.approx(original.position_m, abs=1e-9)
    assert (back.leader == original.leader).all()
    assert back.sha256 == original.sha256


def test_a_recording_can_be_run_again(recorded: tuple[Path, RunResult], tmp_path: Path) -> None:
    output = tmp_path / "again.mcap"
    told: list[tuple[int, int]] = []
    result = run(recorded[1].output, output, on_progress=lambda k, n: told.append((k, n)))
    assert_nothing_lost(result, output)
    assert result.drivers == recorded[1].drivers
    assert [d.vehicle for d in result.drivers] == [0, 1, 2, 3]
    assert all(0.05 < d.one_step_rmse_m < 2.0 for d in result.drivers)
    assert told == sorted(told)
    assert told[-1][1] == 200
    assert [p.name for p in tmp_path.iterdir()] == ["again.mcap"]


def test_compiling_does_not_count_as_time_that_a_node_is_not_heard_of(
    ring_csv: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock of the main job jumps while the code is compiled, by more than nodes get to be heard of."""
    main_job = sys.modules[run.__module__]
    passed = [0.0]
    compile_now = main_job.warm_up

    def compile_slowly() -> None:
        compile_now()
        passed[0] += 10.0 * main_job.START_S

    monkeypatch.setattr(main_job, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + passed[0]))
    monkeypatch.setattr(main_job, "warm_up", compile_slowly)
    result = run(ring_csv, tmp_path / "out.mcap", ring_m=100.0)
    assert_nothing_lost(result, tmp_path / "out.mcap")
    assert passed[0] > main_job.START_S
    assert result.wall_s < passed[0]


def test_a_file_says_of_other_people_only_what_it_says_of_everybody(ring_csv: Path, tmp_path: Path) -> None:
    """Drivers of another recording with the same numbers start as the typical driver, and the command says so."""
    rows = switch_on(ROW.with_effects(defaults(4)), "drag", {"c0": 0.1})
    rows[:, V_STAR] = [8.0, 9.0, 13.0, 14.0]
    rows = switch_on(rows, "preference_switch", {"time": 20.0, "v_star_change": 0.5, "kappa_v_change": 0.0})
    others = tmp_path / "others.csv"
    others.write_text(ring_csv.read_text() + "\n")
    model = tmp_path / "model.yaml"
    write_drivers(model, FittedDrivers(range(4), "", checksum_of(ring_csv), rows, [{}] * 4, {}, 0.0))

    def start_of(source: Path) -> tuple[list[float], list[str], str]:
        use = run(source, source.with_suffix(".mcap"), ring_m=100.0, model=model).use_of_model
        assert use is not None
        with Bag(source.with_suffix(".mcap")) as bag:
            first = [next(bag.messages([f"/vehicle_0{v}/parameters"])).message for v in range(4)]
        known = [dict(zip(one.name, one.value.tolist(), strict=True)) for one in first]
        return [one["v_star"] for one in known], list(first[0].name), start_of_drivers("m.yaml", **asdict(use))

    v_star, names, told = start_of(ring_csv)
    assert v_star == pytest.approx([8.0, 9.0, 13.0, 14.0], rel=0.02)
    assert "preference_switch.v_star_change" in names
    assert told == "m.yaml was fitted to this recording: each driver starts from their own parameters"
    v_star, names, told = start_of(others)
    assert v_star == pytest.approx([11.0] * 4, rel=0.02)
    assert "drag.c0" in names
    assert "preference_switch.v_star_change" not in names
    assert "was fitted to another recording: each driver starts as its typical driver" in told
    assert told.endswith("left out, tied to a moment of its own recording: preference_switch")


def test_a_run_continues_from_the_saved_state_of_another(ring_csv: Path, tmp_path: Path) -> None:
    def parameters(path: Path, which: int) -> dict[str, float]:
        with Bag(path) as bag:
            message = [m.message for m in bag.messages(["/vehicle_02/parameters"])][which]
        return dict(zip(message.name, message.value.tolist(), strict=True))

    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "vehicle_00.json").write_text("of somebody else")
    with pytest.raises(OutputError, match=r"vehicle_00\.json: exists already; choose another"):
        run(ring_csv, tmp_path / "first.mcap", ring_m=100.0, save_state=kept)
    assert (kept / "vehicle_00.json").read_text() == "of somebody else"
    run(ring_csv, tmp_path / "first.mcap", ring_m=100.0, save_state=kept, overwrite=True)
    assert sorted(p.name for p in kept.iterdir()) == [f"vehicle_0{v}.json" for v in range(4)]
    end = parameters(tmp_path / "first.mcap", -1)
    run(ring_csv, tmp_path / "second.mcap", ring_m=100.0, save_state=kept, resume=kept)  # in its own directory
    assert parameters(tmp_path / "second.mcap", 0) == pytest.approx(end, rel=0.01)
    (kept / "vehicle_02.json").write_text("{}")
    with pytest.raises(InputError, match=r"vehicle_02\.json: is no state that an estimator has saved"):
        run(ring_csv, tmp_path / "third.mcap", ring_m=100.0, resume=kept)
    with pytest.raises(InputError, match="nowhere: nothing is known of these vehicles"):
        run(ring_csv, tmp_path / "third.mcap", ring_m=100.0, resume=tmp_path / "nowhere")


def test_filterpy_gives_the_same_estimates(tmp_path: Path) -> None:
    short = tmp_path / "short.csv"
    rows = [f"{0.5 * k},{v},{25.0 * v + 3.0 * k},4.5" for k in range(30) for v in range(2)]
    short.write_text("\n".join(["time_s,vehicle,position_m,length_m", *rows]) + "\n")
    compiled, readable = (run(short, tmp_path / f"{e}.mcap", engine=e).drivers for e in ("compiled", "filterpy"))
    for one, other in zip(compiled, readable, strict=True):
        assert other.v_star == pytest.approx(one.v_star, rel=1e-9)
        assert other.kappa_v == pytest.approx(one.kappa_v, rel=1e-9)
    with pytest.raises(InputError, match="engine: 'unscented' is not known; give compiled or filterpy"):
        run(short, tmp_path / "out.mcap", engine="unscented")


def test_the_truth_of_a_simulation_is_kept(tmp_path: Path) -> None:
    """simulate, run, report: the same truth, also after two runs; markers for every sample, at times of data."""

    def sugiyama(command: str, *files: Path) -> str:
        said = CliRunner().invoke(app, [*command.split(), *map(str, files)])
        assert said.exit_code == 0, said.output
        return said.output

    sugiyama("simulate --vehicles 3 --ring 60 --duration 20 -o", tmp_path / "sim.mcap")
    run(tmp_path / "sim.mcap", tmp_path / "run.mcap")
    run(tmp_path / "run.mcap", tmp_path / "again.mcap")
    told = sugiyama("report", tmp_path / "again.mcap")
    assert "Estimates against the truth" in told
    assert "errors: speed 0." in told
    first, again = (read_truth(tmp_path / name) for name in ("sim.mcap", "again.mcap"))
    assert first is not None
    assert again is not None
    for name in ("time_s", "position_m", "speed", "acceleration", "gap_m"):
        assert getattr(again, name) == pytest.approx(getattr(first, name), nan_ok=True)
    drives = [sorted((d.time_s, d.vehicle, sorted(d.parameters.items())) for d in t.drivers) for t in (again, first)]
    assert drives[0] == drives[1]
    with Bag(tmp_path / "again.mcap") as bag:
        about = bag.info()
        counts = {topic.name: topic.count for topic in about.topics}
    assert counts["/markers"] == counts["/measured"] == 61
    assert about.duration_s == pytest.approx(20.0)


def test_a_slow_estimator_loses_nothing(ring_csv: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    follow = Follower.follow

    def slowly(self: Follower, *arguments: object) -> object:
        if self.vehicle == 2:
            time.sleep(0.005)
        return follow(self, *arguments)

    monkeypatch.setattr(Follower, "follow", slowly)
    assert_nothing_lost(run(ring_csv, tmp_path / "out.mcap", ring_m=100.0), tmp_path / "out.mcap")


def test_a_node_that_stops_is_left_behind(ring_csv: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "PATIENCE_S", 2.0)  # a node that is well tells how far it is at least once a second
    monkeypatch.setattr(recorder, "PATIENCE_S", 1.0)
    monkeypatch.setattr(sys.modules[run.__module__], "STOP_S", 1.0)
    take_in, beat = DriversNode._take_in, PacedNode.beat

    def is_stuck(node: PacedNode) -> bool:
        return isinstance(node, DriversNode) and node.steps >= 50

    monkeypatch.setattr(DriversNode, "_take_in", lambda self, raw: None if is_stuck(self) else take_in(self, raw))
    monkeypatch.setattr(PacedNode, "beat", lambda self: None if is_stuck(self) else beat(self))
    result = run(ring_csv, tmp_path / "out.mcap", ring_m=100.0)
    assert result.steps == 200
    # State and innovation of four drivers in 150 steps.
    assert result.messages_lost == 1200
    with Bag(tmp_path / "out.mcap") as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
        told = {s.message for m in bag.messages(["/diagnostics"]) for s in m.message.status}
    assert (counts["/vehicle_02/state"], counts["/measured"]) == (50, 200)
    assert "gave up waiting for /drivers" in told
    assert any(text.startswith("gave up waiting for /vehicle_00/innovation, /vehicle_00/state") for text in told)


def test_ctrl_c_leaves_a_closed_file(ring_csv: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    code = (
        "import sys; from pathlib import Path; from sugiyama_ros.nodes.run import run;"
        f"r = run(Path({str(ring_csv)!r}), Path({str(output)!r}), rate=2.0, ring_m=100.0,"
        "on_progress=lambda k, n: k >= 8 and print('going', flush=True));"
        "print('ended', r.interrupted, r.messages_lost, r.steps, flush=True)"
    )
    # A terminal sends Ctrl-C to the whole group.
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "going\n"
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=40)
    finally:
        process.kill()
        process.wait()
    ended, interrupted, lost, steps = said.splitlines()[-1].split()
    assert (ended, interrupted, lost) == ("ended", "True", "0")
    assert 8 <= int(steps) < 200
    with Bag(output) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
    assert int(steps) <= counts["/vehicle_03/state"] <= counts["/measured"] < 200


def test_what_is_refused_starts_nothing_and_leaves_no_road_behind(ring_csv: Path, tmp_path: Path) -> None:
    """The next run of this process is in the same DDS domain and would take the road for its own."""
    with pytest.raises(InputError):
        run(tmp_path / "missing.csv", tmp_path / "out.mcap")
    with pytest.raises(OutputError, match="cannot be written"):
        run(ring_csv, tmp_path / "missing" / "out.mcap", ring_m=100.0)
    assert [p.name for p in tmp_path.iterdir()] == ["ring.csv"]
    assert_nothing_lost(run(ring_csv, tmp_path / "kept.mcap", ring_m=100.0), tmp_path / "kept.mcap")


def test_a_node_that_is_refused_leaves_the_old_recording(tmp_path: Path) -> None:
    """Also with --overwrite."""
    (tmp_path / "out.mcap").write_bytes(b"precious")
    crowded = FromSimulator(22, Experiment(ring_m=60.0, duration_s=5.0))
    with pytest.raises(SugiyamaError, match="22 vehicles with gaps of 2 m need 138 m"):
        run(crowded, tmp_path / "out.mcap", overwrite=True)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("out.mcap", b"precious")]
