"""The one room that knows numba: how kernels are compiled and where the machine code is kept.

numba finds a stale cache fresh when only a helper in another file was edited (numba issue 1833),
so the cache folder is named by a digest of all sources that a kernel may be built from.
``error_model="numpy"`` spares a branch at each division, ``nogil`` lets threads share the work,
``fastmath`` stays off because it would let NaN checks vanish; nobody calls kernels through C.
"""

from __future__ import annotations

import gc
import hashlib
import math
import operator
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, event, sigutils, types
from numba.core import ir as numba_ir
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.errors import TypingError
from numba.core.untyped_passes import IRProcessing
from numba.extending import intrinsic

from albedo.errors import InputError

PACKAGE = Path(__file__).resolve().parent


def cache_root() -> Path:
    """Folder that holds compiled kernels: ``ALBEDO_CACHE_DIR``, or the user's cache folder."""
    if chosen := os.environ.get("ALBEDO_CACHE_DIR"):
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "albedo"


@cache
def digest(*folders: Path) -> str:
    """Hexadecimal digest of every Python source below the folders, and of numba's version."""
    sha = hashlib.sha256(numba.__version__.encode())
    for folder in folders:
        for source in sorted(folder.rglob("*.py")):
            sha.update(str(source.relative_to(folder)).encode())
            sha.update(source.read_bytes())
    return sha.hexdigest()[:16]


_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


class _WithoutCollection(event.Listener):
    """Stop the garbage collector while numba compiles: it would walk millions of live objects.

    A seventh of the time of a first call. Compilations nest, and numba runs one at a time.
    """

    def __init__(self) -> None:
        self.depth, self.enabled = 0, False

    def on_start(self, event: event.Event) -> None:
        if self.depth == 0:
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        self.depth -= 1
        if self.depth == 0 and self.enabled:
            gc.enable()


event.register("numba:compile", _WithoutCollection())


def kernel(function: Callable[..., Any], *, forceinline: bool = False) -> Callable[..., Any]:
    """Compile a function of arrays or numbers with numba, and keep the machine code on disk.

    Parameters
    ----------
    function : callable
        A function that numba can compile. When it lives outside this package, the sources in
        its own folder count for the freshness of the cache too.
    forceinline : bool
        Callers contain it, however long it is: see `inlined`.

    Returns
    -------
    callable
        The compiled function; ``.py_func`` is the plain Python one.
    """
    return _compiled(function, "", forceinline=forceinline)


def _compiled(function: Any, suffix: str, **options: Any) -> Any:
    """A dispatcher whose machine code is kept in the folder of its sources, with a suffix."""
    home = Path(function.__code__.co_filename).resolve()
    inside = home.is_relative_to(PACKAGE)
    folders = (PACKAGE,) if inside or not home.is_file() else (PACKAGE, home.parent)
    # numba reads this setting when a function is decorated: set it for this one only.
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(cache_root() / (digest(*folders) + suffix))
    try:
        return numba.njit(cache=home.is_file(), **{**_OPTIONS, **options})(function)
    finally:
        config.CACHE_DIR = before


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel that callers contain: a call hands on six words for every array."""
    return kernel(function, forceinline=True)


_STAND_INS: dict[Any, str] = {}


def stand_in(name: str) -> Callable[[Callable[..., Any]], Any]:
    """An inlined kernel for float64 of what `math` has under a name.

    In other arithmetic, `in_single` or that of `albedo.analysis.precise`, it is that function.
    Products may be added without being rounded, where the processor has that.
    """

    def declare(function: Callable[..., Any]) -> Any:
        _STAND_INS[function] = name
        return _compiled(function, "", forceinline=True, fastmath={"contract"})

    return declare


def stands_for(function: Any) -> str | None:
    """The name in `math` of what a kernel is a stand-in for, if it is one."""
    return _STAND_INS.get(function.py_func)


@intrinsic
def two_to(typing: Any, shifted: Any) -> Any:
    """2^k for kernels, given k + 1.5 2^52 in float64, |k| < 1023: k is in its last bits."""
    whole = ir.IntType(64)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        moved = builder.shl(builder.bitcast(values[0], whole), ir.Constant(whole, 52))
        one = ir.Constant(whole, 1023 << 52)
        return builder.bitcast(builder.add(moved, one), ir.DoubleType())

    return types.float64(types.float64), generate


def is_kernel(function: Any) -> bool:
    """Whether a function has machine code that `address` can find."""
    return isinstance(function, numba.core.dispatcher.Dispatcher)


def translated(function: Any, value_of: Callable[[Any], Any]) -> FunctionType:
    """The source of a kernel as a plain function that finds other globals.

    Parameters
    ----------
    function : callable
        A kernel.
    value_of : callable
        Gives what stands in the place of a global that the kernel reads: another kernel, `math`,
        a number or an array.

    Returns
    -------
    function
        The same code, with these globals and no others.

    Raises
    ------
    InputError
        For what is no kernel, or one that holds values of an enclosing function.
    """
    if not is_kernel(function):
        raise InputError(f"{function!r} is no kernel: it has no source of plain arithmetic")
    source = function.py_func
    if source.__closure__:
        raise InputError(f"the kernel {source.__qualname__} holds values of its own")
    names: dict[str, Any] = {"__builtins__": __builtins__, "__name__": source.__module__}
    for name in source.__code__.co_names:
        if name in source.__globals__:
            names[name] = value_of(source.__globals__[name])
    copied = FunctionType(source.__code__, names, source.__name__, source.__defaults__)
    copied.__qualname__ = source.__qualname__
    return copied


@cache
def in_single(function: Any) -> Any:
    """A kernel compiled anew for float32: every number in it, and in the kernels that it calls.

    numba computes float32 with a float64 constant, or with an integer, in float64. Here constants
    of the source, `math.pi` and global numbers and arrays are rounded to float32, and an integer
    that meets a float32 becomes one. Functions of `math` are those of single precision.

    Parameters
    ----------
    function : callable
        A kernel; it stays what it is.

    Returns
    -------
    callable
        The kernel for arrays of float32, whose machine code is kept on disk as well.

    Raises
    ------
    InputError
        As `translated`.
    """
    options = {"forceinline": bool(function.targetoptions.get("forceinline"))}
    source = translated(function, _single_value)
    # numba's key of a cached function knows nothing of constants: another folder.
    return _compiled(source, "-float32", pipeline_class=_SingleCompiler, **options)


def _single_value(value: Any) -> Any:
    """A constant or global of a kernel in float32."""
    if is_kernel(value):
        name = stands_for(value)
        return getattr(math, name) if name else in_single(value)
    if value is math:
        return _single_math()
    if isinstance(value, float | np.float64):
        # Out of range is infinite, or 0, as in any arithmetic in float32.
        with np.errstate(over="ignore", under="ignore"):
            return np.float32(value)
    if isinstance(value, tuple):
        return tuple(map(_single_value, value))
    if isinstance(value, np.ndarray) and value.dtype == np.float64:
        return value.astype(np.float32)
    return value


@cache
def _single_math() -> ModuleType:
    """`math` with constants in float32; its functions are compiled for what they are given."""
    module = ModuleType("math")
    for name, value in vars(math).items():
        if not name.startswith("_"):
            setattr(module, name, _single_value(value))
    return module


def _mixed(operation: Callable[[Any, Any], Any]) -> Any:
    """An operator for kernels that takes an integer beside a float32 as a float32."""

    @intrinsic
    def apply(typing: Any, left: Any, right: Any) -> Any:
        args = types.unliteral(left), types.unliteral(right)
        integers = [isinstance(kind, types.Integer) for kind in args]
        quotient = operation is operator.truediv and all(integers)
        if quotient or (any(integers) and types.float32 in args):
            args = types.float32, types.float32
        signature = typing.resolve_function_type(operation, args, {})

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return context.get_function(operation, signature)(builder, values)

        return signature, generate

    return apply


_OPERATIONS = ("add", "sub", "mul", "truediv", "lt", "le", "gt", "ge", "eq", "ne")
# Powers stay: numba multiplies them out where the exponent is a whole number in the source.
_MIXED = {getattr(operator, name): _mixed(getattr(operator, name)) for name in _OPERATIONS}


@register_pass(mutates_CFG=False, analysis_only=False)
class _SinglePass(FunctionPass):
    """Round constants to float32, and let operators take integers for such numbers."""

    _name = "albedo_single"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        for block in state.func_ir.blocks.values():
            body: list[Any] = []
            for statement in block.body:
                value = getattr(statement, "value", None)
                if isinstance(value, numba_ir.Const):
                    value.value = _single_value(value.value)
                elif isinstance(value, numba_ir.Expr) and value.op in ("binop", "inplace_binop"):
                    plain = value.fn if value.op == "binop" else value.immutable_fn
                    if plain in _MIXED:
                        body.append(_global(_MIXED[plain], statement, len(body)))
                        args = (value.lhs, value.rhs)
                        statement.value = numba_ir.Expr.call(body[-1].target, args, (), value.loc)
                body.append(statement)
            block.body = body
        # What the replaced statements defined is looked up by later passes.
        state.func_ir._definitions = numba.core.ir_utils.build_definitions(state.func_ir.blocks)
        return True


def _global(function: Any, beside: Any, number: int) -> Any:
    """A statement that names a function, for a call that follows."""
    scope, loc = beside.target.scope, beside.loc
    name = scope.redefine(f"$albedo_{number}", loc)
    return numba_ir.Assign(numba_ir.Global("operation", function, loc), name, loc)


class _SingleCompiler(CompilerBase):
    """numba's own steps, with `_SinglePass` before types are found."""

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_SinglePass, IRProcessing)
        passes.finalize()
        return [passes]


@cache
def address(function: Any, signature: str) -> int:
    """Where the machine code of a kernel begins, for types of arguments written as numba does.

    The code is compiled, or loaded, when it has to be; `indirect` calls it.
    """
    args, result = sigutils.normalize_signature(signature)
    # As for a call: on disk, numba keeps what was compiled for a text or a result apart.
    function.compile(args)
    compiled = function.overloads[args]
    if compiled.signature.return_type != result:
        raise TypingError(f"{function} returns {compiled.signature.return_type}, not {result}")
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def indirect(signature: str) -> Any:
    """What calls, inside a kernel, another kernel that is known by its address alone.

    Passing a kernel as an argument would compile its caller anew for each one.

    Parameters
    ----------
    signature : str
        The types of the arguments of kernels that return nothing, as for `address`.

    Returns
    -------
    callable
        ``call(address, arguments)``, for kernels: `arguments` is a tuple of exactly these types.
    """
    args, result = sigutils.normalize_signature(signature)

    @intrinsic
    def call(typing: Any, address: Any, arguments: Any) -> Any:
        if tuple(arguments) != args:
            raise TypingError(f"a kernel of ({signature}) is called with {arguments}")

        def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
            kind = context.call_conv.get_function_type(result, args)
            callee = builder.inttoptr(values[0], ir.PointerType(kind))
            unpacked = cgutils.unpack_tuple(builder, values[1], len(args))
            status, _ = context.call_conv.call_function(builder, callee, result, args, unpacked)
            with cgutils.if_unlikely(builder, status.is_error):
                context.call_conv.return_status_propagate(builder, status)
            return context.get_dummy_value()

        return types.none(types.intp, arguments), generate

    return call


@contextmanager
def second_compiler(*models: str) -> Iterator[subprocess.Popen[bytes] | None]:
    """On an empty cache, let a second process compile the integrator while this one goes on.

    numba compiles one function at a time in a process, and a first call waits for nothing else.
    The work that this process finds done on disk it need not do; if there is none, nothing changes.

    Parameters
    ----------
    *models : str
        Models about to be integrated, as on the command line: it compiles their nodes too.

    Yields
    ------
    Popen or None
        The second process, if there is one.
    """
    # The folder itself is made as soon as a kernel is declared.
    if any((cache_root() / digest(PACKAGE)).rglob("*.nbi")):
        yield None
        return
    code = "import sys; from albedo.quadrature import compile_ahead; compile_ahead(sys.argv[1:])"
    quiet: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    with subprocess.Popen([sys.executable, "-c", code, *models], **quiet) as helper:
        try:
            yield helper
        finally:
            helper.terminate()
