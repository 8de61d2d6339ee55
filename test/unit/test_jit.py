"""Code is compiled anew once a file that it was made of has changed. Importing changes nothing."""

import importlib
import os
import re
import subprocess
import sys

import pytest

from sugiyama_ros import jit
from sugiyama_ros.entry_points import search_again


@pytest.fixture
def package(tmp_path, monkeypatch):
    (tmp_path / "driver").mkdir()
    (tmp_path / "driver/utility.py").write_text("a = 1\n")
    monkeypatch.setattr(jit, "PACKAGE", tmp_path)
    yield tmp_path
    search_again()
    jit.state.cache_clear()


def state():
    search_again()
    jit.state.cache_clear()
    return jit.state()


def test_a_change_in_a_called_file_changes_the_state(package):
    first = state()
    assert state() == first
    (package / "driver/utility.py").write_text("a = 22\n")
    assert state() != first


def test_other_files_do_not_matter(package):
    first = state()
    (package / "cli.py").write_text("")
    assert state() == first


def test_code_is_not_made_of_the_rooms_after_its_own(package):
    (package / "fit").mkdir()
    first, of_all = jit.state("driver"), state()
    (package / "fit/slopes.py").write_text("a = 1\n")
    assert state() != of_all
    assert jit.state("driver") == first


@pytest.mark.parametrize("name", jit.MADE_OF[2:])
def test_no_room_uses_those_after_it(name):
    later = [one.removesuffix("/*.py") for one in jit.MADE_OF[jit.MADE_OF.index(name) + 1 :]]
    for path in jit.PACKAGE.glob(name):
        used = set(re.findall(r"^from sugiyama_ros\.(\w+)", path.read_text(), re.MULTILINE))
        assert used.isdisjoint({*later, "diagnosis"}), path


def test_all_files_with_compiled_code_are_in_those_rooms():
    rooms = {path for name in jit.MADE_OF for path in jit.PACKAGE.glob(name)}
    kernels = {
        p for p in jit.PACKAGE.rglob("*.py") if re.search(r"^@kernel($|\((?!cached=False))", p.read_text(), re.M)
    }
    assert kernels
    assert kernels <= rooms


@pytest.mark.parametrize("group", jit.GROUPS)
def test_extensions_of_other_packages_matter(package, monkeypatch, tmp_path, group):
    first = state()
    (tmp_path / "site/mine-1.0.dist-info").mkdir(parents=True)
    (tmp_path / "site/mine-1.0.dist-info/entry_points.txt").write_text(f"[{group}]\nsyrup = mine:EFFECT\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    without_file = state()
    (tmp_path / "site/mine.py").write_text("a = 1\n")
    importlib.invalidate_caches()
    with_file = state()
    (tmp_path / "site/mine.py").write_text("a = 22\n")
    assert len({first, without_file, with_file, state()}) == 4


def test_kernels_of_a_changed_file_are_compiled_anew(tmp_path):
    """A kernel that calls a function in another file must not go on with the old function."""
    (tmp_path / "callee.py").write_text("from sugiyama_ros.jit import kernel\n@kernel\ndef f(x):\n    return x + 1.0\n")
    (tmp_path / "caller.py").write_text(
        "from sugiyama_ros import jit\nfrom pathlib import Path\njit.PACKAGE = Path(__file__).parent\n"
        "jit.MADE_OF = ('*.py',)\nfrom callee import f\n@jit.kernel\ndef g(x):\n    return f(x)\nprint(g(1.0))\n"
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "compiled")}

    def run():
        command = [sys.executable, "-c", "import caller"]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()

    assert [run(), run()] == ["2.0", "2.0"]
    (tmp_path / "callee.py").write_text("from sugiyama_ros.jit import kernel\n@kernel\ndef f(x):\n    return x + 9.0\n")
    assert run() == "10.0"
    for index in (tmp_path / "compiled").rglob("*.nbi"):
        index.write_bytes(b"this is no index")
    assert run() == "10.0"


IMPORT = """
import os, sys
from pathlib import Path
before = dict(os.environ)
import sugiyama_ros
assert dict(os.environ) == before, set(os.environ) ^ set(before)
loaded = {name.partition(".")[0] for name in sys.modules}
assert not loaded & {"numba", "rclpy", "scipy", "numpy"}, loaded
assert sugiyama_ros.__version__
"""


def test_importing_the_package_changes_nothing_and_loads_little(tmp_path):
    done = subprocess.run([sys.executable, "-c", IMPORT], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.iterdir())
