"""BLAS threads of a call, in a process that is not ours."""

from __future__ import annotations

from threadpoolctl import ThreadpoolController


class OneBlasThread:
    """A context in which BLAS uses one thread; what was set before comes back.

    The solver's matrices are small: threads that wait for each other cost more than they save. The
    command line sets `OPENBLAS_NUM_THREADS` before NumPy is loaded, which a library cannot.
    """

    def __init__(self) -> None:
        self._blas = ThreadpoolController().select(user_api="blas")

    def __enter__(self) -> None:
        self._limiter = self._blas.limit(limits=1)

    def __exit__(self, *_: object) -> None:
        self._limiter.restore_original_limits()
