"""Run every chapter in eight worlds, and say which of its claims do not hold in all of them.

A world is the arithmetic of a processor and a constant that is added to every seed. Finished runs are kept in
``_build/worlds`` until the page, the library or a result changes, so that a run which was stopped goes on where it
was. The table goes to ``results/worlds.json``, which the status page shows. Exit status 1 when a claim fails, 2 for
bad input.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "book" / "_ext"), str(ROOT / "scripts")]
from fmsync_book import cache_folder, pages, surroundings  # noqa: E402
from other_arithmetic import other_arithmetic  # noqa: E402

from fmsync.files import replacing  # noqa: E402

TABLE = ROOT / "results" / "worlds.json"
_N_SHIFTS = 4
_LONGEST = 900  # seconds that a cell may take


def shifts(seed: int) -> list[int]:
    """The constants that the seeds of the chapters are moved by."""
    return np.random.default_rng(seed).integers(1, 10**6, _N_SHIFTS).tolist()


def run(page: Path, arithmetic: str, shift: int, keep: Path) -> dict:
    """The record of a page in a world: its claims, its warnings, an error that stopped it, its seconds."""
    if keep.is_file():
        return json.loads(keep.read_text(encoding="utf-8"))
    environment = os.environ | {"FMSYNC_SEED_SHIFT": str(shift)}
    if arithmetic == "other":
        environment |= other_arithmetic()
    command = [sys.executable, __file__, "--page", str(page)]
    began = time.perf_counter()
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{page.stem}: the run itself failed\n{done.stderr}")
    record = json.loads(done.stdout.splitlines()[-1]) | {"arithmetic": arithmetic, "shift": shift}
    keep.parent.mkdir(parents=True, exist_ok=True)
    with replacing(keep) as file:
        file.write(json.dumps(record).encode())
    outcome = f"{'; '.join(failures(record)) or 'held'} ({time.perf_counter() - began:.0f} s)"
    print(f"{page.stem} {arithmetic} {shift:+d}: {outcome}", flush=True)
    return record


def run_here(page: Path) -> dict:
    """Execute a page with the environment of this process, its claims recorded (see ``claims.py``)."""
    sys.modules.setdefault("rfc3987_syntax", None)  # jsonschema goes without it, and it takes seconds to import
    from build_book import cpu_of_kernels, quiet_profile
    from jupyter_cache.executors.utils import single_nb_execution
    from myst_nb.core.read import read_myst_markdown_notebook

    notebook = read_myst_markdown_notebook(page.read_text(encoding="utf-8"), path=str(page))
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "claims.jsonl"
        os.environ["FMSYNC_CLAIMS"] = str(told)
        os.environ["IPYTHONDIR"] = quiet_profile(Path(folder), extension=ROOT / "scripts" / "claims.py")
        result = single_nb_execution(notebook, cwd=str(page.parent), timeout=_LONGEST, allow_errors=False)
        records = [json.loads(line) for line in told.read_text(encoding="utf-8").splitlines()] if told.exists() else []
    return {
        "claims": [r for r in records if "claim" in r],
        "warnings": [r["warning"] for r in records if "warning" in r],
        "error": (result.exc_string or "").strip().rpartition("\n")[2] or None if result.err else None,
        "cpu_seconds": round(cpu_of_kernels(), 1),
    }


def failures(record: dict) -> list[str]:
    """What did not hold: claims with their values, convergence warnings, an error."""
    found = []
    for claim in record["claims"]:
        if not claim["holds"]:
            values = " and ".join(f"{v:.4g}" for v in claim["values"] if v is not None)
            margin = "" if claim["margin"] is None else f", margin {claim['margin']:.3g}"
            found.append(f"{claim['claim']}{f': {values}' if values else ''}{margin}")
    found += [f"warning: {text}" for text in record["warnings"]]
    return found + ([f"error: {record['error']}"] if record["error"] else [])


def closest(records: list[dict]) -> list[tuple[float, str]]:
    """Claims with their mean margin in standard deviations between the worlds, the closest first."""
    found = []
    for same in zip(*(r["claims"] for r in records)):
        margins = np.array([np.nan if c["margin"] is None else c["margin"] for c in same])
        if np.isfinite(margins).all() and margins.std() > 1e-9 * abs(margins).max():
            found.append((float(margins.mean() / margins.std(ddof=1)), same[0]["claim"]))
    return sorted(found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("chapters", nargs="*", metavar="CHAPTER", help="names such as 05_oracle; default: all")
    parser.add_argument("--seed", type=int, default=0, help="draws the four shifts (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="runs at the same time (default: %(default)s)")
    parser.add_argument("--native", action="store_true", help="this processor's arithmetic alone; writes no table")
    parser.add_argument("--page", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.page:
        print(json.dumps(run_here(options.page)))
        return 0
    known = {page.stem: page for page in pages()}
    wrong = [f"CHAPTERS: there is no {c!r}; there are {', '.join(known)}" for c in options.chapters if c not in known]
    if "FMSYNC_SEED_SHIFT" in os.environ:
        wrong.append("FMSYNC_SEED_SHIFT: is set by this command; unset it, and choose --seed")
    if wrong:
        print(wrong[0], file=sys.stderr)
        return 2
    chosen = {c: p for c, p in known.items() if not options.chapters or c in options.chapters}
    worlds = [(a, s) for s in shifts(options.seed) for a in (("native",) if options.native else ("native", "other"))]
    columns = [f"{a} {s:+d}" for a, s in worlds]
    folder = ROOT / "_build" / "worlds" / cache_folder().name
    tasks = []
    for page in chosen.values():
        digest = sha256(page.read_bytes()).hexdigest()[:12]
        tasks += [(page, a, s, folder / f"{page.stem}-{digest}-{a}-{s}.json") for a, s in worlds]
    with ThreadPoolExecutor(options.jobs) as pool:
        records = list(pool.map(lambda task: run(*task), tasks))
    failed, table = [], {}
    for k, chapter in enumerate(chosen):
        own = records[k * len(worlds) : (k + 1) * len(worlds)]
        margins = closest(own)
        near, claim = margins[0] if margins else (None, None)
        table[chapter] = {"failures": [failures(r) for r in own], "closest": claim, "margin": near and round(near, 1)}
        held = sum(not failures(r) for r in own)
        told = f"; closest claim {near:.1f} standard deviations: {claim}" if margins else ""
        print(f"{chapter}: {held} of {len(own)}{told}")
        for far, claim in margins[1:]:
            if far < 4:
                print(f"    also close, {far:.1f}: {claim}")
        failed += [f"{chapter} {world}: {line}" for world, r in zip(columns, own) for line in failures(r)]
    if not options.native:
        write_table(table, columns, options.seed)
    print(*failed, sep="\n")
    return bool(failed)


def write_table(table: dict, columns: list[str], seed: int) -> None:
    """Replace the rows of these chapters; rows of other chapters stay when their worlds are the same."""
    before = json.loads(TABLE.read_text(encoding="utf-8")) if TABLE.is_file() else {}
    kept = before.get("chapters", {}) if before.get("worlds") == columns else {}
    rows = {page.stem: (kept | table)[page.stem] for page in pages() if page.stem in kept | table}
    where = {name: surroundings()[name] for name in ("machine", "shapes")}
    told = {"command": f"make worlds SEED={seed}", **where, "worlds": columns, "chapters": rows}
    TABLE.write_text(json.dumps(told, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
