"""Where compiled code is kept from one process to the next.

numba compiles a function anew when its own file changes, but not when a function that it calls does, in another file.
So the compiled code of this package lies in a folder named after the state of all files that it is made of, users'
effects among them.
"""

import hashlib
import os
import shutil
import sys
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

_PACKAGE = Path(__file__).parent
#: Group of entry points by which other packages add effects.
USERS = "sugiyama_ros.effects"
_FOLDER = "compiled-"
_MADE_OF = ("driver/*.py", "laws/*.py", "effects/*.py", "simulation/*.py", "filters/*.py", "fit/*.py", "diagnosis/*.py")


def choose() -> None:
    """Tell numba the folder, unless the user has chosen one or the package cannot be written to."""
    if "NUMBA_CACHE_DIR" in os.environ or not os.access(_PACKAGE, os.W_OK):
        return
    folder = _PACKAGE / "__pycache__" / f"{_FOLDER}{_state()}"
    if not folder.exists():
        for old in folder.parent.glob(f"{_FOLDER}*"):
            shutil.rmtree(old, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)


def _state() -> str:
    """Changes whenever one of the files does."""
    stats = [(path, path.stat()) for pattern in _MADE_OF for path in sorted(_PACKAGE.glob(pattern))]
    state: list[object] = [(str(path.relative_to(_PACKAGE)), s.st_mtime_ns, s.st_size) for path, s in stats]
    for point in sorted(entry_points(group=USERS), key=lambda point: point.name):
        state.append((point.name, point.value, _stat_of(point.module)))
    return hashlib.sha256(repr(state).encode()).hexdigest()[:16]


def _stat_of(module: str) -> tuple[int, int] | None:
    """Time of the last change and size of the file of a user's module, not imported; None if it cannot be found."""
    package, *inner = module.split(".")
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        return None
    file = Path(spec.origin)
    if inner:
        place = file.parent.joinpath(*inner)
        file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    try:
        stat = file.stat()
    except OSError:
        return None
    return stat.st_mtime_ns, stat.st_size
