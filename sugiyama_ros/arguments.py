"""The door of the Python interface: arguments are checked, and converted, as the annotations of a function say.

Numbers may be those of numpy, a whole number is taken where a real one is, and an array where a sequence is. What does
not fit is refused with one line, which names the argument and gives its type as the docstring says it.
"""

import os
import re
import reprlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache, wraps
from inspect import Parameter, signature
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, SimpleNamespace, UnionType
from typing import Annotated, Any, Literal, ParamSpec, Protocol, TypeVar, Union, get_args, get_origin, get_type_hints
from typing import runtime_checkable as checkable

import numpy as np
from numpy.typing import ArrayLike

from sugiyama_ros.errors import InputError

_P = ParamSpec("_P")
_R = TypeVar("_R")
#: What numpy can make an array of real numbers of.
Numbers = Annotated[ArrayLike, np.float64]
# A parameter in a section of numpydoc: names, and the type.
_DECLARED = re.compile(r"^ {0,4}((?:\w+, )*\w+) : (.+?)(?:, optional)?$", re.MULTILINE)


@checkable
class _Frame(Protocol):
    """A data frame of pandas, which need not be installed, or of a library like it."""

    columns: Any


class _UnfitError(ValueError):
    """A value does not fit an annotation."""


def checked(settings: type | None = None) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Make a public function check and convert its arguments. The function raises InputError for what does not fit.

    settings: a class whose fields are the keywords that the function takes by ``**``.
    """

    def decorate(function: Callable[_P, _R]) -> Callable[_P, _R]:
        known = signature(function)

        @cache
        def hints() -> dict[str, Any]:
            frames = {"pandas": SimpleNamespace(DataFrame=_Frame)}
            own = get_type_hints(function, localns=frames, include_extras=True)
            return (get_type_hints(settings, include_extras=True) if settings else {}) | own

        def taken(name: str, value: Any) -> Any:
            try:
                return _fitted(value, hints().get(name, Any))
            except _UnfitError:
                texts = (function.__doc__ or "", settings.__doc__ or "" if settings else "")
                what = next(filter(None, (_declared(text, name) for text in texts)), hints()[name])
                raise InputError(f"{name}: {reprlib.repr(value)} is not possible; give {what}") from None

        @wraps(function)
        def call(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            given = known.bind(*args, **kwargs)
            for name, value in given.arguments.items():
                if known.parameters[name].kind is Parameter.VAR_KEYWORD:
                    given.arguments[name] = {key: taken(key, one) for key, one in value.items()}
                else:
                    given.arguments[name] = taken(name, value)
            return function(*given.args, **given.kwargs)

        return call

    return decorate


def _declared(text: str, name: str) -> str:
    """The type of an argument in a docstring; empty if the docstring does not say it."""
    return next((kind for names, kind in _DECLARED.findall(text) if name in names.split(", ")), "")


def _fitted(value: Any, hint: Any) -> Any:
    """A value as an annotation says. Raises _UnfitError."""
    origin, parts = get_origin(hint), get_args(hint)
    if hint is Any or (hint is NoneType and value is None):
        return value
    if origin in (Union, UnionType):
        return _first_fitted(value, parts)
    if origin is Annotated:
        return _array(value)
    if isinstance(value, np.ndarray | np.generic) and (value.ndim == 0 or origin is not None):
        value = value.tolist()
    if origin is Literal and isinstance(value, str) and value in parts:
        return value
    if isinstance(origin, type) and issubclass(origin, Mapping) and isinstance(value, Mapping):
        return {_fitted(key, parts[0]): _fitted(one, parts[1]) for key, one in value.items()}
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return _sequence(value, origin, parts)
    if hint in (int, float) and not isinstance(value, bool) and isinstance(value, Integral if hint is int else Real):
        return _number(value, hint)
    if hint is Path and isinstance(value, os.PathLike):
        return Path(value)
    if isinstance(hint, type) and hint not in (int, float) and isinstance(value, hint):
        return value
    raise _UnfitError


def _first_fitted(value: Any, parts: Sequence[Any]) -> Any:
    """A value as the first of some annotations says that fits. Raises _UnfitError."""
    for part in parts:
        try:
            return _fitted(value, part)
        except _UnfitError:
            continue
    raise _UnfitError


def _sequence(value: Any, kind: type, parts: Sequence[Any]) -> Any:
    """A list, or a tuple whose parts have annotations of their own. Raises _UnfitError."""
    if (
        isinstance(value, str | bytes | Mapping | _Frame)
        or not hasattr(value, "__len__")
        or not hasattr(value, "__getitem__")
    ):
        raise _UnfitError
    each = list(value)
    if not issubclass(kind, tuple):
        return [_fitted(one, parts[0]) for one in each]
    each_part = [parts[0]] * len(each) if parts[-1] is ... else parts
    if len(each) != len(each_part):
        raise _UnfitError
    return tuple(_fitted(one, part) for one, part in zip(each, each_part, strict=True))


def _number(value: Any, kind: type) -> Any:
    """A number that fits into 64 bits. Raises _UnfitError."""
    try:
        number = kind(value)
    except OverflowError:
        raise _UnfitError from None
    if kind is int and not -(2**63) <= number < 2**63:
        raise _UnfitError
    return number


def _array(value: Any) -> Any:
    """An array of real numbers. Raises _UnfitError."""
    try:
        array = np.asarray(value)
        is_text = array.dtype.kind == "O" and any(isinstance(one, str | bytes | bool) for one in array.flat)
        if array.ndim and array.dtype.kind in "iufO" and not is_text:
            return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        pass
    raise _UnfitError
