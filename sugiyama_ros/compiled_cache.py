"""Where compiled code is kept from one process to the next.

numba compiles a function anew when its own file changes, but not when a function that it calls does, in another file.
So the compiled code of this package lies in a folder named after the state of all files that it is made of.
"""

import hashlib
import os
import shutil
import sys
from pathlib import Path

_PACKAGE = Path(__file__).parent
_FOLDER = "compiled-"
_MADE_OF = ("driver/*.py", "effects/*.py", "estimation/*.py", "criticism/*.py", "simulation.py")


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
    state = [(str(path.relative_to(_PACKAGE)), s.st_mtime_ns, s.st_size) for path, s in stats]
    return hashlib.sha256(repr(state).encode()).hexdigest()[:16]
