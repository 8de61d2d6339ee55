"""Importing the package changes nothing in the process."""

import subprocess
import sys
import textwrap

SCRIPT = """
    import importlib, os, pkgutil
    before = dict(os.environ)
    import sugiyama_ros
    for module in pkgutil.walk_packages(sugiyama_ros.__path__, "sugiyama_ros."):
        if module.name.endswith("__main__"):
            continue
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as error:
            # an optional package, or ROS where it is not installed
            assert not (error.name or "").startswith("sugiyama_ros"), error
    print(" ".join(name for name in before.keys() | os.environ.keys() if before.get(name) != os.environ.get(name)))
"""


def test_imports_leave_the_environment_as_it_was() -> None:
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(SCRIPT)], capture_output=True, text=True, check=False, timeout=200
    )
    assert done.returncode == 0, done.stderr
    assert not done.stdout.split()


def loaded_by(module: str, names: set[str]) -> set[str]:
    """Which of these modules are loaded when a module is imported."""
    script = f"import sys, {module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=200)
    return names & set(done.stdout.split())


def test_files_are_read_without_compiled_code() -> None:
    assert not loaded_by("sugiyama_ros.formats.registry", {"scipy", "numba", "rosbags"})


def test_the_papers_calibration_loads_no_more_than_it_needs() -> None:
    others = {"scipy.optimize", "scipy.stats", "scipy.cluster", "filterpy", "sugiyama_ros.filters.causal"}
    assert not loaded_by("sugiyama_ros.calibration.calibrate", others)
