"""Code is compiled anew once something that it is made of has changed. Importing changes nothing."""

import os
import subprocess
import sys
from types import ModuleType
from typing import Any

import pytest

from sugiyama_ros.effects.registry import EFFECTS
from sugiyama_ros.filters import causal, online_step
from sugiyama_ros.fingerprint import fingerprint, kernels_in
from sugiyama_ros.laws.registry import LAWS, RIVALS
from sugiyama_ros.simulation import drive, free_run

CODE = """
from typing import NamedTuple
import numpy as np
from sugiyama_ros.jit import kernel
TABLE, FACTOR = np.arange(3.0), 2.0

class Pair(NamedTuple):
    first: float
    second: float

@kernel
def inner(x):
    return FACTOR * x

@kernel
def outer(pair: Pair) -> float:
    return inner(pair.first) + TABLE[1]
"""


def made(text: str) -> Any:
    """The kernel ``outer`` of a module with this text."""
    module = ModuleType("a_module")
    exec(compile(text, __file__, "exec"), module.__dict__)
    return module.outer


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("def outer(pair: Pair) -> float:", 'def outer(pair: Pair) -> float:\n    """Say something."""'),
        ("import numpy as np", "import numpy as np\n# a comment, and other lines\n\nOTHER = 3.0\n"),
    ],
)
def test_comments_and_places_do_not_matter(old: str, new: str) -> None:
    assert fingerprint(made(CODE)) == fingerprint(made(CODE.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("TABLE[1]", "TABLE[2]"),
        ("FACTOR * x", "FACTOR + x"),
        ("np.arange(3.0), 2.0", "np.arange(3.0), 2.5"),
        ("np.arange(3.0), 2.0", "np.arange(4.0), 2.0"),
        ("first: float\n    second: float", "second: float\n    first: float"),
        ("@kernel\ndef inner", "@kernel(vectorised=True)\ndef inner"),
    ],
)
def test_code_constants_fields_and_options_matter(old: str, new: str) -> None:
    assert fingerprint(made(CODE)) != fingerprint(made(CODE.replace(old, new)))


@pytest.mark.parametrize(
    "function", [causal.run, online_step.step, drive.drive, free_run.run_single], ids=lambda f: f.__name__
)
def test_no_effect_and_no_law_is_part_of_a_filter_or_of_a_simulation(function: Any) -> None:
    """What is installed, edited or removed beside them, they need not be compiled anew."""
    inside = {id(one) for one in kernels_in(function)}
    assert len(inside) > 20
    functions = [LAWS[name].function for name in RIVALS]
    for effect in EFFECTS.values():
        functions += [effect.function, effect.noise_factor, effect.displacement, effect.measurement_noise_factor]
        functions += [effect.memory and effect.memory.change, effect.contamination and effect.contamination.weigh]
    assert inside.isdisjoint(id(one) for one in functions if one is not None)


def test_kernels_of_a_changed_file_are_compiled_anew(tmp_path):
    """A kernel that calls a function in another file must not go on with the old function."""
    (tmp_path / "callee.py").write_text("from sugiyama_ros.jit import kernel\n@kernel\ndef f(x):\n    return x + 1.0\n")
    (tmp_path / "caller.py").write_text(
        "from sugiyama_ros import jit, progress\nfrom callee import f\n"
        "@jit.kernel\ndef g(x):\n    return f(x)\n"
        "told = []\nprogress.on_compiling = lambda what, done, total: told.append((done, total))\n"
        "print(g(1.0), told[:1], told[-1:])\n"
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "compiled")}

    def run():
        command = [sys.executable, "-c", "import caller"]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()

    # the share that is done goes from nothing to all
    assert [run(), run()] == ["2.0 [(0, 3)] [(3, 3)]", "2.0 [] []"]
    (tmp_path / "callee.py").write_text("from sugiyama_ros.jit import kernel\n@kernel\ndef f(x):\n    return x + 9.0\n")
    assert run() == "10.0 [(0, 3)] [(3, 3)]"
    for index in (tmp_path / "compiled").rglob("*.nbi"):
        index.write_bytes(b"this is no index")
    assert run() == "10.0 [(0, 3)] [(3, 3)]"


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


def test_ctrl_c_while_a_function_is_compiled_comes_after_its_address_is_known() -> None:
    code = """
import signal
from types import SimpleNamespace
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background ignores it
from sugiyama_ros import by_address

later = []  # in place of a timer, which a busy machine may be too slow for
timer = lambda _, call: SimpleNamespace(start=lambda: later.append(call))
by_address.threading = SimpleNamespace(Timer=timer)

def compiled(pending=[signal.SIGINT]):
    if pending:
        signal.raise_signal(pending.pop())
    return 7

place = by_address.reserve(1)
by_address._functions[place] = compiled
try:
    print(by_address._resolve(place))
    later[0]()
    for _ in range(1000): pass
    print("nothing came")
except KeyboardInterrupt:
    print("interrupted")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("7\ninterrupted\n", "")
