"""The one room that knows numba: how kernels are compiled and where the machine code is kept.

numba finds a stale cache fresh when only a helper in another file was edited (numba issue 1833),
so the cache folder is named by a digest of all sources that a kernel may be built from.
``error_model="numpy"`` spares a branch at each division, ``nogil`` lets threads share the work,
``fastmath`` stays off because it would let NaN checks vanish; nobody calls kernels through C.
"""

from __future__ import annotations

import gc
import hashlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numba
from llvmlite import ir
from numba.core import cgutils, event, sigutils, types
from numba.core.errors import TypingError
from numba.extending import intrinsic

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
    home = Path(function.__code__.co_filename).resolve()
    inside = home.is_relative_to(PACKAGE)
    folders = (PACKAGE,) if inside or not home.is_file() else (PACKAGE, home.parent)
    # numba reads this setting when a function is decorated: set it for this one only.
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(cache_root() / digest(*folders))
    try:
        options = {**_OPTIONS, "forceinline": forceinline}
        return numba.njit(cache=home.is_file(), **options)(function)
    finally:
        config.CACHE_DIR = before


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel that callers contain: a call hands on six words for every array."""
    return kernel(function, forceinline=True)


def is_kernel(function: Any) -> bool:
    """Whether a function has machine code that `address` can find."""
    return isinstance(function, numba.core.dispatcher.Dispatcher)


@cache
def address(function: Any, signature: str) -> int:
    """Where the machine code of a kernel begins, for types of arguments written as numba does.

    The code is compiled, or loaded, when it has to be; `indirect` calls it.
    """
    function.compile(signature)
    args, _ = sigutils.normalize_signature(signature)
    compiled = function.overloads[args]
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
def second_compiler(*models: str) -> Iterator[None]:
    """On an empty cache, let a second process compile the integrator while this one goes on.

    numba compiles one function at a time in a process, and a first call waits for nothing else.
    The work that this process finds done on disk it need not do; if there is none, nothing changes.

    Parameters
    ----------
    *models : str
        Models about to be integrated, as on the command line: it compiles their nodes too.
    """
    # The folder itself is made as soon as a kernel is declared.
    if any((cache_root() / digest(PACKAGE)).rglob("*.nbi")):
        yield
        return
    code = "import sys; from albedo.quadrature import compile_ahead; compile_ahead(sys.argv[1:])"
    quiet: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    with subprocess.Popen([sys.executable, "-c", code, *models], **quiet) as helper:
        try:
            yield
        finally:
            helper.terminate()
