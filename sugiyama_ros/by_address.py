"""Compiled functions that compiled code calls by their address, which it looks up in a table when it runs.

A function that is called by its address is no part of its caller: it can come, change and go, and its caller stays as
it is. Two kinds of functions are called so: those of effects and laws, and functions that take long to compile and have
several callers.

The table is a block of memory with a name that the linker knows. Kept code holds the name; each process puts the block
where it likes, and fills in the addresses of its own. A function is compiled or loaded when its address is first asked
for.

A call by address costs some 8 ns more than a direct call, a call of one of numba's first-class functions 2.4 ns more
(numba 0.68, a function of two numbers); a mean action takes some 250 ns. But a tuple of first-class functions has to be
handed down to every caller, its length is part of its type, and numba calls them experimental.
"""

import _thread
import ctypes
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numba
import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

#: Places of the table that compiled code holds as constants: of the functions of a batch, and of the heads of hooks.
BATCH_AT, HOOKS_AT, _FREE_FROM = 1, 16, 128
_NAME, _WORDS = "sugiyama_ros_table", 8192
_WORD = ir.IntType(64)
# Time [s] after which an interrupt that came while a function was compiled is raised again.
_LATER_S = 0.05
# The first word is the address of `_resolve`, for compiled code that finds no address.
_TABLE = np.zeros(_WORDS, np.int64)
_functions: dict[int, Callable[[], int]] = {}
_used = _FREE_FROM


def reserve(words: int) -> int:
    """Reserve words of the table, whose place compiled code looks up in the table; returns the first one."""
    global _used
    first, _used = _used, _used + words
    assert _used <= _WORDS
    return first


def put(place: int, words: Sequence[int]) -> None:
    """Put numbers into the table, from a place on."""
    _TABLE[place : place + len(words)] = words


def offer(place: int, make: Callable[[], Any], signature: Any) -> None:
    """Offer a function at a place of the table, where compiled code finds its address."""
    _functions[place] = lambda: address_of(make(), signature)
    _TABLE[place] = 0


def look_up(place: int) -> int:
    """Return the address at a place of the table; the function is compiled or loaded if it has none yet."""
    if not _TABLE[place]:
        _TABLE[place] = _functions[place]()
    return int(_TABLE[place])


def offered() -> tuple[int, ...]:
    """Return the places at which functions are offered."""
    return tuple(_functions)


def address_of(function: Any, signature: Any) -> int:
    """Compile or load a function; returns the address of its machine code."""
    function.alone.compile(signature)
    compiled = function.alone.overloads[tuple(signature.args)]
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


@ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)
def _resolve(place: int) -> int:
    """Fill in an address; compiled code calls this, from any thread. Returns 0 if the function cannot be compiled."""
    interrupted = False
    while not _TABLE[place]:
        try:
            look_up(place)
        except KeyboardInterrupt:  # compiled code has to come to its end before Python can see this
            interrupted = True
        except Exception:
            sys.excepthook(*sys.exc_info())
            break
    if interrupted:
        # raised at once, it would leave this function without a result, and its caller would call what is no address
        threading.Timer(_LATER_S, _thread.interrupt_main).start()
    return int(_TABLE[place])


_TABLE[0] = ctypes.cast(_resolve, ctypes.c_void_p).value or 0
binding.add_symbol(_NAME, _TABLE.ctypes.data)


def _place(builder: Any, place: Any) -> Any:
    """Write the code that finds a word of the table."""
    module, kind = builder.module, ir.ArrayType(_WORD, _WORDS)
    table = module.globals.get(_NAME) or ir.GlobalVariable(module, kind, _NAME)
    table.linkage = "external"
    return builder.gep(table, [ir.Constant(_WORD, 0), place], inbounds=True)


def _word(_: Any, place: Any) -> Any:
    """Return a word of the table."""
    return types.int64(types.int64), lambda context, builder, sig, args: builder.load(_place(builder, args[0]))


#: (place) -> word, for compiled code.
word: Any = intrinsic(_word)


def _entry_of(_: Any, row: Any, place: Any) -> Any:
    """Return the entry of an array (N,) at the index that a word of the table holds."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        data = context.make_array(row)(context, builder, values[0]).data
        # the table holds no negative index, for which numba would look first
        return builder.load(builder.gep(data, [builder.load(_place(builder, values[1]))], inbounds=True))

    if not (isinstance(row, types.Array) and row.layout == "C" and row.ndim == 1):
        raise TypingError(f"a row must be an array of one dimension without gaps, not {row}")
    return row.dtype(row, types.int64), generate


#: (row, place) -> entry of the row, for compiled code.
entry_of: Any = intrinsic(_entry_of)


def _part_of(_: Any, row: Any, place: Any) -> Any:
    """Return the part of an array (N,) from the index that a word of the table holds to the one in the next word.

    Nobody counts references to it, so compiled functions that count none can pass it on.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind, whole = signature.return_type, context.make_array(row)(context, builder, values[0])
        part = context.make_array(kind)(context, builder)
        first = builder.load(_place(builder, values[1]))
        end = builder.load(_place(builder, builder.add(values[1], ir.Constant(_WORD, 1))))
        populate_array(
            part,
            data=builder.gep(whole.data, [first]),
            shape=cgutils.pack_array(builder, [builder.sub(end, first)]),
            strides=whole.strides,
            itemsize=whole.itemsize,
            meminfo=None,
        )
        return part._getvalue()

    if not (isinstance(row, types.Array) and row.layout == "C" and row.ndim == 1):
        raise TypingError(f"a row must be an array of one dimension without gaps, not {row}")
    return row(row, types.int64), generate


#: (row, place) -> part of the row, for compiled code.
part_of: Any = intrinsic(_part_of)


def type_of(value: Any) -> Any:
    """Return numba's type of a value."""
    return numba.typeof(value)


def calling(result: Any, *arguments: Any) -> tuple[Any, Any]:
    """Make a function that calls what stands in the table.

    Returns signature: as ``offer`` takes it; call: (place, argument, ...) -> result, for compiled code.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kinds = signature.args[1]
        given = [builder.extract_value(values[1], k) for k in range(len(kinds))]
        given = [context.cast(builder, *one) for one in zip(given, kinds, arguments, strict=True)]
        place = _place(builder, values[0])
        address = cgutils.alloca_once_value(builder, builder.load(place))
        with cgutils.if_unlikely(builder, builder.icmp_unsigned("==", builder.load(address), ir.Constant(_WORD, 0))):
            resolve = ir.FunctionType(_WORD, [_WORD]).as_pointer()
            first = builder.load(_place(builder, ir.Constant(_WORD, 0)))
            found = builder.call(builder.inttoptr(first, resolve), [values[0]])
            with cgutils.if_unlikely(builder, builder.icmp_unsigned("==", found, ir.Constant(_WORD, 0))):
                context.call_conv.return_user_exc(builder, RuntimeError, ("a function could not be compiled",))
            builder.store(found, address)
        kind = context.call_conv.get_function_type(result, arguments)
        function = builder.inttoptr(builder.load(address), kind.as_pointer())
        status, returned = context.call_conv.call_function(builder, function, result, arguments, given)
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return returned

    def call(_: Any, place: Any, *given: Any) -> Any:
        star: Any = types.StarArgTuple
        return result(types.int64, star(given)), generate

    return result(*arguments), intrinsic(call)
