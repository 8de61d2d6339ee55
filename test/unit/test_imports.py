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
