"""Compile: the decorators of the kernels and the flags that all of them share."""

import numba

# Without Numba's runtime a kernel that allocates does not compile, and a call does not count references to every array
# of a model, which took ten times as long as the arithmetic. Fast arithmetic is off, as it would give one arm other
# last digits than several abreast; what it gains most, `fused` gains too.
FLAGS = {"cache": True, "_nrt": False, "error_model": "numpy"}
kernel = numba.njit(**FLAGS)  # what Python calls
released = numba.njit(**FLAGS, nogil=True)  # what Python calls in several threads
inner = numba.njit(**FLAGS, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)  # what other kernels call
