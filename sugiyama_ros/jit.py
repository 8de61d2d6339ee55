"""The only place for compiler options: how the functions in the inner loops are compiled, and where the code is kept.

Every compiled function of this package is decorated with `kernel`. What its options are worth: the causal filter takes
2.9 times as long without the vector instructions of ``vectorised``, 2.3 times as long if references are counted, 1.25
times as long if kernels are not put into their callers, and with the drivers on two threads 1.9 times as long without
``nogil`` (2 cores, numba 0.68, November 2026).

Compiled code is kept where numba keeps it: in ``__pycache__`` beside the source, in NUMBA_CACHE_DIR if that is set, or
in the user's cache folder. numba compiles a function anew when its own file changes, but not when a function that it
calls changes in another file. Here it is compiled anew when its `fingerprint` changes: its own code, the code of
everything that becomes part of it, or a constant in there. Comments and other functions of the same file do not matter.

Functions that compiled code calls by their address (``by_address``) are no part of their callers: the effects, the laws
and the mean actions. So the filter is compiled without them, and once for all of them.

The filter of recordings is compiled in one version: numbers of vehicles, samples, adapted parameters and periods of
look-ahead are values, one chain is a case of chains side by side, and the precision of the mean actions is chosen when
they are called. The online filter has a version of the same functions of its own, for a state without gaps in memory.
"""

import hashlib
import sys
from collections.abc import Callable, Iterable
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, overload

from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.extending import register_jitable

from sugiyama_ros import interrupts, progress
from sugiyama_ros.fingerprint import fingerprint, kernels_in

_Function = TypeVar("_Function", bound=Callable[..., Any])
# How everything is compiled follows from this file.
_COMPILER = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
# Options for a function that Python does not call.
_ALONE = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@overload
def kernel(function: _Function) -> _Function: ...
@overload
def kernel(
    *, allocates: bool = ..., vectorised: bool = ..., cached: bool = ...
) -> Callable[[_Function], _Function]: ...
def kernel(
    function: Any = None,
    *,
    allocates: bool = True,
    vectorised: bool = False,
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
    cached : bool
        False for a function that is made of others at run time, which numba cannot keep.

    Returns
    -------
    callable
        The compiled function.
    """
    if function is None:
        options = {"allocates": allocates, "vectorised": vectorised, "cached": cached}
        return lambda one: kernel(one, **options)
    given: dict[str, Any] = {"nogil": True}
    if vectorised:
        given["error_model"] = "numpy"
    if not allocates:
        given["forceinline"] = True
        try:
            return Kernel(function, {"_nrt": False, **given}, cached)
        except (TypeError, KeyError):  # a numba without this option
            pass
    return Kernel(function, given, cached)


def in_python_too(function: _Function) -> _Function:
    """Let compiled code call a function that stays a function of Python for Python."""
    registered: _Function = register_jitable(function)
    return registered


class _Progress:
    """How far the compilation of a function is; numba compiles one at a time."""

    def __init__(self) -> None:
        self.what, self.done, self.total = "", 0, 0

    def begin(self, function: Any) -> None:
        """Begin with a function. What it calls comes first; then the machine code takes half as long."""
        parts = sum(1 for _ in kernels_in(function))
        self.what, self.done, self.total = function.py_func.__qualname__, 0, parts + parts // 2
        self.tell()

    def add(self) -> None:
        """Go on after one function has become part of the function."""
        self.done = min(self.done + 1, self.total * 2 // 3)
        self.tell()

    def end(self) -> None:
        """End."""
        self.done = self.total
        self.tell()

    def tell(self) -> None:
        """Tell who wants to know."""
        if progress.on_compiling is not None and self.total:
            progress.on_compiling(self.what, self.done, self.total)


_progress = _Progress()


class _Part(CPUCodeLibrary):
    """Code that becomes part of its callers. It is optimised with them, and needs no machine code of its own."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def _finalize_specific(self) -> None:
        pass

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: there is no machine code."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> "_Part":
        """Who sets the environment."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing: the environment is that of the callers."""


class _Inside(Compiler):
    """Compiles a function for its callers alone."""

    part: type[_Part] = _Part

    def __init__(self, typingctx: Any, targetctx: Any, library: Any, *rest: Any) -> None:
        super().__init__(typingctx, targetctx, library or self.part(targetctx.codegen(), "part"), *rest)


class _Loop(_Part):
    """Code with a loop over numbers: it is made vector instructions before callers unroll it."""

    def _optimize_final_module(self) -> None:
        CPUCodeLibrary._optimize_final_module(self)


class _InsideLoop(_Inside):
    """Compiles a function with a loop over numbers for its callers alone."""

    part = _Loop


class _Version(CPUDispatcher):
    """A version of a kernel with machine code of its own."""

    def compile(self, sig: Any) -> Any:
        """Compile or load it for these types of arguments."""
        with interrupts.compiling():
            return super().compile(sig)


class Kernel(CPUDispatcher):
    """A compiled function. It becomes part of compiled code that calls it; Python calls another version, ``entry``.

    A function that is called by compiled code alone is never compiled on its own: neither machine code nor the code
    that unpacks Python's objects is made of it, which would take most of the time.

    Parameters
    ----------
    py_func : function
        The Python function.
    targetoptions : dict
        Options of numba.
    cached : bool
        Whether compiled code is kept.
    made_of : iterable of object
        What else the compiled code depends on, such as the class of an argument.
    """

    def __init__(
        self, py_func: Any, targetoptions: dict[str, Any], cached: bool = True, made_of: Iterable[Any] = (), **rest: Any
    ) -> None:
        self._given = {"nopython": True, "boundscheck": None, **targetoptions}
        self._kept, self._made_of = cached, tuple(made_of)
        inside = _InsideLoop if targetoptions.get("error_model") == "numpy" else _Inside
        super().__init__(py_func, targetoptions=self._given | _ALONE, pipeline_class=inside, **rest)

    @cached_property
    def entry(self) -> Any:
        """The version that Python calls."""
        return self._version("entry", {})

    @cached_property
    def alone(self) -> Any:
        """The version that compiled code calls by its address; see ``by_address``."""
        return self._version("alone", _ALONE)

    def compile(self, sig: Any) -> Any:
        """Compile a version for callers with these types of arguments, unless there is one."""
        before = len(self.overloads)
        compiled = super().compile(sig)
        if len(self.overloads) > before:
            _progress.add()
        return compiled

    def _version(self, use: str, options: dict[str, Any]) -> Any:
        version: Any = _Version(self.py_func, targetoptions=self._given | options)
        if self._kept:
            version._cache = _Cache(self.py_func, self, self._made_of, use)
        return version

    def __call__(self, *arguments: Any) -> Any:
        return self.entry(*arguments)

    def __reduce__(self) -> Any:
        return self.py_func.__qualname__  # pickled by its name, as a function of Python is


class _Cache(FunctionCache):
    """Where numba keeps the compiled code of one function, which goes out of date with what it is made of.

    numba itself compares the time of the function's file alone, and the number of the line where the function begins.
    """

    def __init__(self, py_func: Any, function: Any, made_of: tuple[Any, ...], use: str) -> None:
        self._name, self._py_func = repr(py_func), py_func
        self._impl = self._impl_class(py_func)
        self._cache_path = self._impl.locator.get_cache_path()
        self._function, self._made_of, self._use = function, made_of, use
        self.enable()

    @cached_property
    def _cache_file(self) -> "_File":  # type: ignore[override]
        """The file, when the function is first called: now all constants that it refers to have their values."""
        one = self._py_func
        name = f"{one.__module__}.{one.__qualname__}.{self._use}.{sys.implementation.cache_tag}"
        return _File(self._cache_path, name, _COMPILER + fingerprint(self._function, self._made_of))

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a version; where there is none, its compilation begins now."""
        found = super().load_overload(sig, target_context)
        if found is None:
            _progress.begin(self._function)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a version, whose compilation has just ended."""
        _progress.end()
        super().save_overload(sig, data)


class _File(IndexDataCacheFile):
    """The index of the compiled versions of one function, and their files."""

    def save(self, key: Any, data: Any) -> None:
        """Keep a version in a file of its own, and only then name it in the index.

        numba numbers the files, so that two processes that keep different versions at the same time may exchange them.
        """
        name = f"{Path(self._index_name).stem}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"
        self._save_data(name, data)
        self._save_index(self._load_index() | {key: name})

    def _load_index(self) -> Any:
        """Read the index. An index may name a class that is gone, and then cannot be read."""
        try:
            return super()._load_index()
        except Exception:
            return {}
