"""The only place for compiler options: how the functions in the inner loops are compiled, and where the code is kept.

Every compiled function of this package is decorated with `kernel`. ``python -m sugiyama_ros.studies.compiler`` measures
what each option is worth, by compiling the causal filter without it. Time without an option over time with all of them,
on one thread (CPU) and with the drivers on two threads (least of 25 rounds, 2 cores, numba 0.68, November 2026):

============  ==========  ===========
without       one thread  two threads
============  ==========  ===========
numpy         2.88        2.69
nrt           2.34        2.15
into_callers  1.25        1.23
inline        0.97        1.00
nogil         1.01        1.92
============  ==========  ===========

Compiled code is kept where numba keeps it: in ``__pycache__`` beside the source, in NUMBA_CACHE_DIR if that is set, or
in the user's cache folder. numba compiles a function anew when its own file changes, but not when a function that it
calls changes in another file. So the stamp that numba compares is replaced by one of all files that the compiled code
may be made of, effects and laws of other packages among them.
"""

import contextlib
import hashlib
from collections.abc import Callable
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar, overload

from numba import njit

from sugiyama_ros.entry_points import entry_points

_Function = TypeVar("_Function", bound=Callable[..., Any])
PACKAGE = Path(__file__).parent
# Rooms with compiled code; none calls the compiled code of a room after it.
_ROOMS = ("driver", "laws", "effects", "filters", "simulation", "fit")
#: Files that compiled code is made of.
MADE_OF = ("jit.py", "arrays.py", *(f"{room}/*.py" for room in _ROOMS))
#: Groups of entry points whose functions are compiled into ours.
GROUPS = ("sugiyama_ros.effects", "sugiyama_ros.laws")
#: Options that the benchmark switches off, one after the other.
OPTIONS = {"nogil", "nrt", "numpy", "inline", "into_callers"}


@overload
def kernel(function: _Function) -> _Function: ...
@overload
def kernel(
    *, allocates: bool = ..., vectorised: bool = ..., inline: bool = ..., cached: bool = ...
) -> Callable[[_Function], _Function]: ...
def kernel(
    function: Any = None,
    *,
    allocates: bool = True,
    vectorised: bool = False,
    inline: bool = False,
    cached: bool = True,
) -> Any:
    """Compile a function.

    All kernels release the global interpreter lock (``nogil``), so that drivers are filtered on threads. No option
    lets the compiler change the order of floating-point operations: results are the same each time they are compiled.

    Parameters
    ----------
    function : callable
        The function; left out where options are given.
    allocates : bool
        False for a function that makes no arrays. It then does not count references to the arrays that it is given
        (numba's private option ``_nrt``; where numba does not know it, references are counted). Its machine code is put
        into its callers (``forceinline``), which would otherwise pass some hundred numbers for a state and its arrays.
    vectorised : bool
        True for a function with a loop over numbers. Dividing by zero then gives infinity instead of an exception
        (``error_model="numpy"``), without which compilers make no vector instructions of the loop.
    inline : bool
        True for a function whose code is put into its callers, so that they count no references for it either.
    cached : bool
        False for a function that is made of others at run time, which numba cannot keep.

    Returns
    -------
    callable
        The compiled function.
    """
    if function is None:
        options = {"allocates": allocates, "vectorised": vectorised, "inline": inline, "cached": cached}
        return lambda one: kernel(one, **options)
    given: dict[str, Any] = {"nogil": "nogil" in OPTIONS, "cache": cached}
    if vectorised and "numpy" in OPTIONS:
        given["error_model"] = "numpy"
    if inline and "inline" in OPTIONS:
        given["inline"] = "always"
    if not allocates and "into_callers" in OPTIONS:
        given["forceinline"] = True
    if not allocates and "nrt" in OPTIONS:
        try:
            return _kept(njit(function, _nrt=False, **given), cached)  # type: ignore[call-overload]
        except (TypeError, KeyError):  # a numba without this option
            pass
    return _kept(njit(function, **given), cached)


def _kept(compiled: Any, cached: bool) -> Any:
    """Make numba compile anew whenever one of all the files changes, or where it cannot read what it has kept."""
    if cached:
        with contextlib.suppress(AttributeError):  # a numba that keeps its code elsewhere: its own rules stay
            file = compiled._cache._cache_file
            stamp = state(compiled.py_func.__module__.removeprefix("sugiyama_ros.").partition(".")[0])
            file._source_stamp, file._load_index = stamp, partial(_index, file._load_index)
    return compiled


def _index(load: Callable[[], dict[Any, Any]]) -> dict[Any, Any]:
    """Index of the code that numba has kept. An index may name a class that is gone, and then cannot be read."""
    try:
        return load()
    except Exception:
        return {}


@cache
def state(room: str = "") -> str:
    """Identify the files that compiled code is made of, by their times and sizes.

    Parameters
    ----------
    room : str
        Folder of the code, which is made of files in this folder and in those before it. Code from elsewhere may be
        made of all files.

    Returns
    -------
    str
        A checksum.
    """
    own = f"{room}/*.py"
    patterns = MADE_OF[: MADE_OF.index(own) + 1] if own in MADE_OF else MADE_OF
    stats = [(path, path.stat()) for pattern in patterns for path in sorted(PACKAGE.glob(pattern))]
    found: list[object] = [(str(path.relative_to(PACKAGE)), s.st_mtime_ns, s.st_size) for path, s in stats]
    for group in GROUPS:
        for point in entry_points(group):
            found.append((group, point.name, point.value, _stat_of(point.module)))
    found.append(sorted(OPTIONS))
    return hashlib.sha256(repr(found).encode()).hexdigest()


def _stat_of(module: str) -> tuple[int, int] | None:
    """Time and size of the file of another package's module, which is not imported; None if it cannot be found."""
    package, *inner = module.split(".")
    try:
        spec = find_spec(package)
        if spec is None or spec.origin is None:
            return None
        file = Path(spec.origin)
        if inner:
            place = file.parent.joinpath(*inner)
            file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
        stat = file.stat()
    except (OSError, ValueError):
        return None
    return stat.st_mtime_ns, stat.st_size
