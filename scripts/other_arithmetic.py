"""Run a command with the arithmetic of another processor: the instructions that an old one lacked are not used.

``python scripts/other_arithmetic.py pytest --nbmake book/notebooks``
"""

import os
import platform
import sys


def other_arithmetic() -> dict[str, str]:
    """Environment variables under which NumPy, SciPy and Numba compute as on an old processor of this architecture."""
    from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

    kernel = "Nehalem" if platform.machine() in ("x86_64", "AMD64") else "ARMV8"
    used = [feature for feature in __cpu_dispatch__ if __cpu_features__[feature]]
    found = {"OPENBLAS_CORETYPE": kernel, "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    return found | ({"NPY_DISABLE_CPU_FEATURES": " ".join(used)} if used else {})


if __name__ == "__main__":
    os.execvpe(sys.argv[1], sys.argv[1:], os.environ | other_arithmetic())
