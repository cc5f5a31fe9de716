"""Build the book: execute the chapters side by side into the execution cache, then render the pages from it."""

import argparse
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml
from jupyter_cache import get_cache
from jupyter_cache.base import CacheBundleIn
from jupyter_cache.executors.utils import single_nb_execution
from myst_nb.core.read import read_myst_markdown_notebook

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "book" / "_ext"))
_KEPT_CACHES = 4  # with and without the TOSCA cats, and the two before


def pages() -> list[Path]:
    """Executable pages of the table of contents."""
    toc = yaml.safe_load((ROOT / "book" / "_toc.yml").read_text(encoding="utf-8"))
    entries = list(toc.get("chapters", []))
    for part in toc.get("parts", []):
        entries += part["chapters"]
    files = [ROOT / "book" / f"{entry['file']}.md" for entry in entries]
    return [f for f in files if "kernelspec:" in f.read_text(encoding="utf-8")[:600]]


def execute(page: Path, folder: Path) -> str | None:
    """Run one page unless its outputs are in the cache; gives the traceback of the cell that failed, or None."""
    notebook = read_myst_markdown_notebook(page.read_text(encoding="utf-8"), path=str(page))
    cache = get_cache(str(folder))
    try:
        cache.match_cache_notebook(notebook)
        return None
    except KeyError:
        pass
    result = single_nb_execution(notebook, cwd=str(page.parent), timeout=300, allow_errors=False)
    if result.err:
        return f"{page.name} failed after {result.time:.1f} s\n{result.exc_string}"
    bundle = CacheBundleIn(notebook, str(page), data={"execution_seconds": result.time})
    cache.cache_notebook_bundle(bundle, check_validity=False, overwrite=True)
    print(f"executed {page.name} in {result.time:.1f} s", flush=True)
    return None


def drop_old_caches(current: Path) -> None:
    """Edits of the library leave caches behind; keep the latest few."""
    current.mkdir(parents=True, exist_ok=True)
    os.utime(current)
    for old in sorted(current.parent.iterdir(), key=lambda p: p.stat().st_mtime)[:-_KEPT_CACHES]:
        shutil.rmtree(old)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=2, help="chapters executed at the same time")
    jobs = parser.parse_args().jobs
    from fmsync_book import cache_folder

    os.environ["FMSYNC_SHARED_VIEWER"] = "1"  # the built pages share one viewer file
    folder = cache_folder()
    drop_old_caches(folder)
    get_cache(str(folder)).db  # noqa: B018  creates the database before two threads would
    with ThreadPoolExecutor(jobs) as pool:  # threads: the work happens in the kernels
        failures = [f for f in pool.map(lambda page: execute(page, folder), pages()) if f]
    if failures:
        print(*failures, sep="\n\n")
        return 1
    shutil.rmtree(ROOT / "_build" / "html", ignore_errors=True)  # pages taken out of the contents would linger
    command = "jupyter-book build book --config _config.yml --path-output . -W -n --keep-going --all"
    return subprocess.run(command.split(), cwd=ROOT).returncode


if __name__ == "__main__":
    sys.exit(main())
