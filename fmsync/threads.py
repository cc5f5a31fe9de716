"""One BLAS thread around loops over small matrices: two make 20 x 20 products several times slower."""

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController

_controller = cache(ThreadpoolController)  # looking through the loaded libraries takes milliseconds: done once


def single_threaded_blas() -> AbstractContextManager[object]:
    """Context manager that limits BLAS to one thread."""
    return _controller().limit(limits=1, user_api="blas")
