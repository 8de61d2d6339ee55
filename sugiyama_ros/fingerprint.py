"""What a compiled function is made of: its code, the values that the compiler takes as constants, and what it calls."""

import hashlib
import types
from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any

import numpy as np

# Packages whose functions a compiler knows by name. Compiled code is kept apart for each version of numba.
_FOREIGN = {"numpy", "numba", "llvmlite", "math", "cmath", "builtins", "typing", "collections", "functools", "operator"}


def reachable(function: Any) -> dict[int, Any]:
    """Find all that is compiled together with a function.

    function: a Python function, or a compiled function with its Python function in ``py_func``.
    """
    found: dict[int, Any] = {}
    waiting = [function]
    while waiting:
        one = waiting.pop()
        if id(one) not in found:
            found[id(one)] = one
            waiting.extend(_described(one)[1])
    return found


def fingerprint(function: Any, also: Iterable[Any] = ()) -> str:
    """Identify the machine code that a compiler makes of a function.

    Comments, docstrings, and the place of a function in its file do not matter.

    function: as for ``reachable``.
    """
    parts = {i: one for start in (function, *also) for i, one in reachable(start).items()}
    return hashlib.sha256("\n".join(sorted(_described(one)[0] for one in parts.values())).encode()).hexdigest()


@cache
def _described(one: Any) -> tuple[str, tuple[Any, ...]]:
    """Describe a function or a class on its own; and return the functions and classes that it refers to."""
    refers: list[Any] = []
    if isinstance(one, type):
        fields = getattr(one, "_fields", ())
        kinds = getattr(one, "__annotations__", {}).values() if fields else ()
        refers.extend(kind for kind in kinds if isinstance(kind, type) and not _is_foreign(kind))
        return repr((_name_of(one), fields)), tuple(refers)
    function = getattr(one, "py_func", None) or getattr(one, "_defn", None) or one
    names, code = _code(function.__code__, function.__doc__)
    kinds = [kind for kind in function.__annotations__.values() if isinstance(kind, type)]
    refers.extend(kind for kind in kinds if not _is_foreign(kind))
    found = [_value(function.__defaults__, refers)]
    found += [_value(cell.cell_contents, refers) for cell in function.__closure__ or ()]
    for name in names:
        if name in function.__globals__:
            value = function.__globals__[name]
            found.append(f"{name}={_value(value, refers)}")
            if isinstance(value, types.ModuleType) and not _is_foreign(value):
                found += [f"{name}.{n}={_value(getattr(value, n), refers)}" for n in names if hasattr(value, n)]
    options = sorted(getattr(one, "targetoptions", {}).items())
    return repr((_name_of(function), code, found, options)), tuple(refers)


def _code(code: types.CodeType, doc: str | None) -> tuple[list[str], str]:
    """Return the names that code uses, and a description of what it does; with the code inside it."""
    names, parts = list(code.co_names), [code.co_code.hex(), repr(code.co_names + code.co_varnames + code.co_freevars)]
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            inner_names, inner = _code(constant, None)
            names += inner_names
            parts.append(inner)
        elif constant is not doc and constant != doc:
            parts.append(repr(constant))
    return sorted(set(names)), repr(parts)


def _value(value: Any, refers: list[Any]) -> str:
    """Describe a value that compiled code holds as a constant; functions and classes are added to ``refers``."""
    if isinstance(value, np.ndarray):
        return f"array {value.dtype} {value.shape} {hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
    if isinstance(value, tuple | list | frozenset | set):
        parts = [_value(one, refers) for one in value]
        return f"({', '.join(sorted(parts) if isinstance(value, frozenset | set) else parts)})"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | slice | range | np.generic):
        return repr(value)
    if not _is_foreign(value) and (callable(value) and (_is_code(value) or isinstance(value, type))):
        refers.append(value)
    return _name_of(value)


def _is_code(value: Any) -> bool:
    """Whether a value has Python code of its own."""
    return any(
        isinstance(getattr(value, name, None), types.FunctionType) for name in ("py_func", "_defn")
    ) or isinstance(value, types.FunctionType)


def _is_foreign(value: Any) -> bool:
    """Whether a function, class or module is known by its name: it is of numba, or of a library that numba knows."""
    module = value.__name__ if isinstance(value, types.ModuleType) else getattr(value, "__module__", None)
    return str(module).partition(".")[0] in _FOREIGN


def _name_of(value: Any) -> str:
    """Return a name that is the same in every process."""
    if isinstance(value, types.ModuleType):
        return value.__name__
    named = value if hasattr(value, "__qualname__") else type(value)
    return f"{named.__module__}.{named.__qualname__}"


def kernels_in(function: Any) -> Iterator[Any]:
    """Yield the compiled functions in ``reachable``."""
    return (one for one in reachable(function).values() if hasattr(one, "py_func"))
