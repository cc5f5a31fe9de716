"""Kernels forked from a process that has already imported what every page imports: each saves one to two seconds."""

import multiprocessing
import os
import signal
import sys
import threading
from ctypes import c_double
from importlib.metadata import EntryPoint
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from ipykernel.kernelapp import IPKernelApp
from jupyter_client.provisioning import KernelProvisionerFactory, LocalProvisioner

_seconds: list[c_double] = []
# what pages take longest to import, and what this module and the program that uses it do: each kernel imports them too
_IMPORTED = ["data_gen.collections", "fmsync.matching", "fmsync.viz", "pandas", "pyvista"]
_IMPORTED += ["ipykernel.kernelapp", "jupyter_cache.executors.utils", "myst_nb.core.read", "sphinx.util.docutils"]
_BUILDERS = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "book" / "_ext")]


def use_forked_kernels() -> None:
    """From here on, kernels that this process starts are forked; elsewhere than on Linux that is not safe."""
    if sys.platform != "linux":
        return
    # a kernel sets it as well, but here matplotlib has been imported by then
    os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
    multiprocessing.get_context("forkserver").set_forkserver_preload(_IMPORTED)
    factory = KernelProvisionerFactory.instance()
    factory.provisioners["forked"] = EntryPoint("forked", f"{__name__}:Forked", factory.GROUP_NAME)
    factory.default_provisioner_name = "forked"


def cpu_of_kernels() -> float:
    """Seconds of processor time of the kernels that this process has seen end, without imports that they share."""
    return sum(used.value for used in _seconds) + sum(os.times()[2:4])  # the latter of those that were not forked


def _serve(command: list[str], folder: str, environment: dict[str, str], used: c_double) -> None:
    os.setsid()  # whoever stops the kernel stops what it has started
    threading.Thread(target=_end_with, args=(multiprocessing.parent_process(),), daemon=True).start()
    os.chdir(folder)
    os.environ.update(environment)
    sys.path[:] = [place for place in sys.path if place not in ("", *_BUILDERS)]  # as in any kernel, and the rest too
    multiprocessing.set_start_method(None, force=True)
    options = command[command.index("ipykernel_launcher") + 1 :]
    IPKernelApp.launch_instance([*options, f"--IPKernelApp.parent_handle={os.getppid()}"])  # or it says how to end it
    used.value = sum(os.times()[:4])


def _end_with(starter: BaseProcess) -> None:
    starter.join()
    os.killpg(0, signal.SIGKILL)


class _Started:
    """A forked process with the names of ``subprocess.Popen``."""

    stdin = stdout = stderr = None

    def __init__(self, process: BaseProcess):
        self._process, self.pid, self.kill, self.terminate = process, process.pid, process.kill, process.terminate

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self) -> int | None:
        self._process.join()
        return self._process.exitcode

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)


class Forked(LocalProvisioner):
    """Forks kernels; to stop them, it treats them like any other."""

    async def launch_kernel(self, cmd: list[str], **kwargs: Any) -> dict[str, Any]:
        forks = multiprocessing.get_context("forkserver")
        _seconds.append(forks.Value("d", lock=False))
        process = forks.Process(target=_serve, args=(cmd, kwargs["cwd"], kwargs["env"], _seconds[-1]))
        process.start()
        self.process, self.pid, self.pgid = _Started(process), process.pid, process.pid
        return self.connection_info
