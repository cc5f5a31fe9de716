"""Build the book: execute the chapters side by side into the execution cache, then render the pages from it."""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path

from jupyter_cache import get_cache
from jupyter_cache.base import CacheBundleIn
from jupyter_cache.executors.utils import single_nb_execution

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "book" / "_ext"))
from fmsync_book import cache_folder, notebook_of, pages, surroundings  # noqa: E402
from forked_kernels import cpu_of_kernels, use_forked_kernels  # noqa: E402

_KEPT_CACHES = 4  # with and without the TOSCA cats, and the two before


def execute(page: Path, folder: Path) -> str | None:
    """Run one page unless its outputs are in the cache; gives the traceback of the cell that failed, or None."""
    notebook, cache = notebook_of(page), get_cache(str(folder))
    try:
        cache.match_cache_notebook(notebook)
        return None
    except KeyError:
        pass
    before = cpu_of_kernels()
    result = single_nb_execution(notebook, cwd=str(page.parent), timeout=300, allow_errors=False)
    if result.err:
        return f"{page.name} failed after {result.time:.1f} s\n{result.exc_string}"
    data = {"execution_seconds": result.time, "cpu_seconds": cpu_of_kernels() - before, **surroundings()}
    cache.cache_notebook_bundle(CacheBundleIn(notebook, str(page), data=data), check_validity=False, overwrite=True)
    print(f"executed {page.name} in {result.time:.1f} s", flush=True)
    return None


def quiet_profile(folder: Path, extension: Path | None = None) -> str:
    """A folder for IPython that is nobody's own: kernels tell of errors there, not of the sockets they talk through.

    ``extension`` is the file of an IPython extension that they load.
    """
    lines = ["c.IPKernelApp.log_level = 40"]
    if extension is not None:
        lines += [f"import sys; sys.path.append({str(extension.parent)!r})"]
        lines += [f"c.InteractiveShellApp.extensions = [{extension.stem!r}]"]
    (folder / "profile_default").mkdir()
    (folder / "profile_default" / "ipython_kernel_config.py").write_text("\n".join(lines) + "\n")
    return str(folder)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2, help="chapters executed at the same time")
    jobs = parser.parse_args().jobs
    os.environ["FMSYNC_SHARED_VIEWER"] = "1"  # the built pages share one viewer file
    folder = cache_folder()
    folder.mkdir(parents=True, exist_ok=True)
    os.utime(folder)
    for old in sorted(folder.parent.iterdir(), key=lambda p: p.stat().st_mtime)[:-_KEPT_CACHES]:
        shutil.rmtree(old)  # edits of the library leave caches behind
    get_cache(str(folder)).db  # noqa: B018  creates the database before two processes would
    with (
        tempfile.TemporaryDirectory() as profile,
        ProcessPoolExecutor(jobs, get_context("spawn"), use_forked_kernels) as pool,
    ):
        os.environ["IPYTHONDIR"] = quiet_profile(Path(profile))
        longest_first = sorted(pages(), key=lambda page: -page.stat().st_size)  # no core waits for a long last page
        failures = [f for f in pool.map(execute, longest_first, repeat(folder)) if f]
    if failures:
        print(*failures, sep="\n\n")
        return 1
    shutil.rmtree(ROOT / "_build" / "html", ignore_errors=True)  # pages taken out of the contents would linger
    command = "jupyter-book build book --config _config.yml --path-output . -W -n --keep-going --all"
    return subprocess.run(command.split(), cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main())
