"""Both ways of installing, pip and colcon: what they install where, and that the versions agree."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[2]
NODES = ("critic", "drivers", "keeper", "recorder", "replay", "simulator", "tracks")
PROGRAMS = {"sugiyama", *(f"sugiyama_{node}" for node in NODES)}
INTERFACES = sorted([*ROOT.glob("msg_defs/msg/*.msg"), *ROOT.glob("msg_defs/srv/*.srv")])

#: Fields without a unit of their own; a covariance has the units of its variables.
WITHOUT_UNIT = {"covariance", "log_likelihood", "nis", "weight"}


def run(*command: str | Path, cwd: Path, env: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command as in a fresh shell: without the variables that the wheels and make set for this process."""
    mine = {
        "LD_LIBRARY_PATH",
        "AMENT_PREFIX_PATH",
        "PYTHONPATH",
        "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
        "MAKEFLAGS",
        "MAKELEVEL",
    }
    fresh = {name: value for name, value in os.environ.items() if name not in mine}
    return subprocess.run(command, cwd=cwd, env={**fresh, **(env or {})}, capture_output=True, text=True, check=False)


def copy_of_the_tree(place: Path) -> Path:
    passing = (".*", "__pycache__", "build", "install", "log", "*.egg-info", "*.mcap")
    return Path(shutil.copytree(ROOT, place, ignore=shutil.ignore_patterns(*passing)))


def shared_files() -> dict[str, Path]:
    """Path below share/sugiyama_ros of each file that belongs there, and its source."""
    files = [ROOT / "package.xml", *ROOT.glob("launch/*.launch.py"), *ROOT.glob("config/*.yaml")]
    return {file.relative_to(ROOT).as_posix(): file for file in files}


@pytest.fixture
def installed() -> metadata.Distribution:
    try:
        return metadata.distribution("sugiyama_ros")
    except metadata.PackageNotFoundError:
        pytest.skip("sugiyama_ros is not installed")


def test_versions_agree(installed: metadata.Distribution) -> None:
    version = ElementTree.parse(ROOT / "package.xml").findtext("version")
    assert installed.version == version
    assert ElementTree.parse(ROOT / "msg_defs/package.xml").findtext("version") == version
    assert f'\nversion = "{version}"\n' in (ROOT / "msg_defs/pyproject.toml").read_text()


def test_build_of_the_messages_uses_the_pinned_versions() -> None:
    required = set(re.findall(r'^    "(.+==.+)",$', (ROOT / "msg_defs/pyproject.toml").read_text(), re.MULTILINE))
    assert "ros-ament-cmake==2.5.4" in required
    pinned = {line.removesuffix(" \\") for line in (ROOT / "requirements.txt").read_text().splitlines()}
    assert required <= pinned


@pytest.mark.parametrize("path", INTERFACES, ids=lambda path: path.name)
def test_every_number_of_an_interface_has_a_unit(path: Path) -> None:
    for line in path.read_text().splitlines():
        if line.startswith("float64"):
            field, _, comment = line.partition("#")
            name = field.split()[1]
            assert comment.strip(), f"{name}: what is it?"
            assert name in WITHOUT_UNIT or re.search(r"\[\S+\]|\bSI units\b", comment), f"{name}: in which unit?"
            for suffix, unit in (("_per_m", "[1/m]"), ("_m", "[m]"), ("_s", "[s]")):
                if not name.endswith(suffix):
                    continue
                assert unit in comment, f"{name} is not in {unit}"
                break


def test_installed_share_directory_is_found_and_current(
    installed: metadata.Distribution, monkeypatch: pytest.MonkeyPatch
) -> None:
    packages = pytest.importorskip("ament_index_python.packages")
    prefixes = [sys.prefix, os.environ.get("AMENT_PREFIX_PATH", "")]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(filter(None, prefixes)))
    share = Path(packages.get_package_share_directory("sugiyama_ros"))
    for place, source in shared_files().items():
        assert (share / place).read_text() == source.read_text(), f"{place} is not the one of this tree: run make"
    assert Path(packages.get_package_share_directory("sugiyama_msgs")).is_dir()


def test_every_program_starts_something_that_exists(installed: metadata.Distribution) -> None:
    pytest.importorskip("rclpy")
    programs = {entry.name: entry for entry in installed.entry_points if entry.group == "console_scripts"}
    assert set(programs) == PROGRAMS
    for entry in programs.values():
        assert callable(entry.load())


def test_console_script_is_on_the_path_of_the_environment(installed: metadata.Distribution) -> None:
    script = Path(sys.prefix, "bin", "sugiyama")
    if not script.exists():
        pytest.skip("not installed by pip")
    help_text = run(script, "--help", cwd=Path("/"))
    assert help_text.returncode == 0, help_text.stderr
    assert "demo" in help_text.stdout


def test_plain_wheel_holds_programs_and_data(tmp_path: Path) -> None:
    tree = copy_of_the_tree(tmp_path / "a tree")
    built = run(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", tree, cwd=tmp_path)
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("sugiyama_ros-*.whl")
    with zipfile.ZipFile(wheel) as content:
        names = {name.split(".data/data/")[-1] for name in content.namelist()}
        (entry_points,) = (content.read(name).decode() for name in names if name.endswith("/entry_points.txt"))
    assert {f"share/sugiyama_ros/{place}" for place in shared_files()} <= names
    assert "share/ament_index/resource_index/packages/sugiyama_ros" in names
    assert {source.relative_to(ROOT).as_posix() for source in ROOT.glob("sugiyama_ros/**/*.py")} <= names
    assert set(re.findall(r"^(\w+) =", entry_points, re.MULTILINE)) == PROGRAMS


def test_make_without_a_usable_python_says_so_in_one_line(tmp_path: Path) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)
    failed = run("make", "PYTHON=python-of-nobody", "demo", cwd=tmp_path)
    error, of_make = failed.stderr.splitlines()
    assert error == "error: python-of-nobody not found; choose Python 3.10-3.13 with PYTHON="
    assert of_make.startswith("make: ***")
    assert not (tmp_path / ".venv").exists()
