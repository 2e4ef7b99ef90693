"""How functions over the state of worlds are compiled, and what of numba's own is used for that.

Numba's cache on disk checks the types of arguments and the file of the kernel itself, but no other file. So
its keys have a digest of all files with kernels here: if one of them changes, every kernel is compiled again.
"""

from __future__ import annotations

import hashlib
import random
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import _helperlib, njit, types
from numba.core import cgutils
from numba.core.caching import FunctionCache, NullCache
from numba.core.ccallback import CFunc
from numba.core.codegen import get_host_cpu_features
from numba.extending import intrinsic
from numba.np import arrayobj

PACKAGE = Path(__file__).parents[1]
KERNEL_SOURCES = (
    "env/compiling.py", "env/kernel.py", "env/observe.py", "env/reward.py", "env/rules.py", "env/state.py",
    "engines/mlp.py", "engines/products.py", "engines/batched/initial_weights.py",
    "engines/batched/optimizers.py", "engines/batched/rollout.py", "engines/batched/update.py",
)  # fmt: skip
"""Files whose code, or whose constants, are compiled into kernels."""
DIGEST = hashlib.sha256(b"".join((PACKAGE / name).read_bytes() for name in KERNEL_SOURCES)).hexdigest()[:16]


def cached(signature: Any = None, notice: str = "", **options: Any) -> Callable[[Any], Any]:
    """Return `njit`, or `cfunc`, with a cache; where no folder can be written, each process compiles again.

    Numba writes next to the code, in the user's cache, or in NUMBA_CACHE_DIR; in some containers it can write
    to none of them.

    Args:
        signature: of a C function, which is compiled at once.
        notice: what a person at a terminal is shown if nothing is in the cache.
        options: of the decorator.
    """

    def compiled(function: Any) -> Any:
        cache_index: Any = {}
        try:
            cache: Any = typed_cache(function)
        except RuntimeError:  # no such folder
            cache = NullCache()
        else:
            try:
                cache_index = cache._cache_file._load_index()
            except Exception:  # it names a class that is gone, and is read whole before its age is seen
                cache.flush()
        if notice and not cache_index and sys.stderr.isatty():
            print(notice, file=sys.stderr)
        if signature is None:
            # without what C would call: compiled functions call it directly
            kernel = typed_njit(no_cfunc_wrapper=True, **options)(function)
            kernel._cache = cache
        else:
            kernel = typed_cfunc(function, (signature.args, signature.return_type), {}, options)
            kernel._cache = cache
            kernel.compile()
        return kernel

    return compiled


class _KernelCache(FunctionCache):
    """Numba's cache of a kernel, which an edit of any file with kernels makes old."""

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        key: Any = super()._index_key
        return (*key(signature, codegen), DIGEST)


# Only the call from outside can be called from outside: the code that takes Python's arguments
# apart would take longer to compile than the rules. Nothing allocates, so all do without
# numba's reference counts, which took half the time of a step.
_INNER: Any = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False}
entry: Any = cached(error_model="numpy", nogil=True)
kernel: Any = njit(**_INNER)
inlined: Any = njit(**_INNER, forceinline=True)
inlined_early: Any = njit(**_INNER, inline="always")  # by numba before compiling: for the few large ones
typed_intrinsic: Any = intrinsic
typed_arrays: Any = arrayobj
typed_codegen: Any = cgutils
typed_helpers: Any = _helperlib
_GENERATOR_ADDRESSES = (typed_helpers.rnd_get_np_state_ptr, typed_helpers.rnd_get_py_state_ptr)
typed_void: Any = types.void
typed_float: Any = types.float32
typed_double: Any = types.float64
typed_pointer: Any = types.CPointer
typed_tuple: Any = types.NamedTuple
typed_cfunc: Any = CFunc
typed_njit: Any = njit
typed_cache: Any = _KernelCache


@entry
def seed_compiled(seed: int) -> None:
    """Seed numba's own generators, from which a user's compiled code may draw."""
    random.seed(seed)
    np.random.seed(seed)


def target_features() -> str:
    """Return the features of the processor for which numba compiles, as LLVM names them."""
    config: Any = numba.config
    if config.CPU_FEATURES is not None:  # set by NUMBA_CPU_FEATURES
        return str(config.CPU_FEATURES)
    host_features: Any = get_host_cpu_features
    return str(host_features())


def compiled_states() -> list[Any]:
    """Return the states of numba's own generators, for `restore_compiled`."""
    return [typed_helpers.rnd_get_state(address()) for address in _GENERATOR_ADDRESSES]


def restore_compiled(states: list[Any]) -> None:
    for address, state in zip(_GENERATOR_ADDRESSES, states, strict=True):
        typed_helpers.rnd_set_state(address(), state)


def array_from(codegen: Any, builder: Any, array_type: Any, address: Any, lengths: Any) -> Any:
    """Generate the array of a type and lengths at an address, or a pointer."""
    array = typed_arrays.make_array(array_type)(codegen, builder)
    item_bytes = codegen.get_abi_sizeof(codegen.get_data_type(array_type.dtype))
    item_size = codegen.get_constant(types.intp, item_bytes)
    strides = [item_size]
    for length in reversed(lengths[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    if isinstance(address.type, ir.IntType):
        data_pointer = builder.inttoptr(address, array.data.type)
    else:
        data_pointer = builder.bitcast(address, array.data.type)
    typed_arrays.populate_array(array, data_pointer, lengths, strides, item_size, None)
    return array._getvalue()
