"""Where a result was made: machine, versions and commit."""

import os
import platform
import re
import subprocess
from functools import cache
from importlib.metadata import distributions
from pathlib import Path

_VERSIONS = ("fmsync", "numpy", "scipy", "numba", "pymanopt", "geomstats", "pyfmaps")


@cache
def machine() -> str:
    """Processor, cores and system."""
    cpus = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*:\s*(.+)", cpus.read_text()) if cpus.exists() else []
    return f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores, {platform.system()}"


@cache
def versions() -> str:
    """Python and the libraries that results depend on."""
    found = {known.name: known.version for known in distributions()}
    told = [f"{name} {found[name]}" for name in _VERSIONS if name in found]
    return ", ".join([f"python {platform.python_version()}", *told])


def current_commit() -> str:
    """Commit of the checkout that holds this package, with "+" behind it when files differ; else "unknown"."""
    command = ["git", "describe", "--always", "--abbrev=12", "--dirty=+", "--exclude=*"]
    try:
        return subprocess.check_output(command, cwd=Path(__file__).parent, stderr=subprocess.DEVNULL, text=True).strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
