"""The one place through which the chapters of the book take their seeds."""

import os

from fmsync import checks

_VARIABLE = "FMSYNC_SEED_SHIFT"


@checks.checked(number=">= 0")
def seed(number: int) -> int:
    """``number`` itself or, in a test, ``number`` plus a constant.

    What a chapter claims must not depend on its seeds. Tests run it with other ones: they set the environment variable
    ``FMSYNC_SEED_SHIFT`` to an integer (ValueError otherwise), which is added here, modulo :math:`2^{32}`.

    >>> from data_gen import seed
    >>> seed(3) - seed(2)
    1
    """
    shift = os.environ.get(_VARIABLE, "0")
    try:
        return (number + int(shift)) % 2**32
    except ValueError:
        told = "expected an integer, such as 1000; unset it for the book's own seeds"
        raise ValueError(f"{_VARIABLE}={shift!r}: {told}") from None
