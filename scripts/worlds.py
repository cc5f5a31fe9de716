"""Run every chapter in eight worlds, and say which of its claims do not hold in all of them.

A world is the arithmetic of a processor and a constant that is added to every seed. Finished runs are kept in
``_build/worlds`` until the page, the library or a result changes, so that a run which was stopped goes on where it
was. The table goes to ``results/worlds.json``, which the status page shows. Exit status 1 when a claim fails, 2 for
bad input.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from unittest import mock

import numpy as np
from jupyter_cache.executors.utils import single_nb_execution

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "book" / "_ext"), str(ROOT / "scripts")]
from build_book import quiet_profile  # noqa: E402
from fmsync_book import cache_folder, notebook_of, pages, surroundings  # noqa: E402
from other_arithmetic import other_arithmetic  # noqa: E402

from fmsync.files import replacing  # noqa: E402

TABLE = ROOT / "results" / "worlds.json"
_N_SHIFTS = 4
_LONGEST = 900  # seconds that a cell may take


def shifts(seed: int) -> list[int]:
    """The constants that the seeds of the chapters are moved by."""
    return np.random.default_rng(seed).integers(1, 10**6, _N_SHIFTS).tolist()


def run(page: Path, arithmetic: str, shift: int, keep: Path) -> None:
    """Write the record of a page in a world (see ``claims.py``): claims, warnings, what stopped it, its seconds."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "claims.jsonl"
        profile = quiet_profile(Path(folder), extension=ROOT / "scripts" / "claims.py")
        world = {"FMSYNC_SEED_SHIFT": str(shift), "FMSYNC_CLAIMS": str(told), "IPYTHONDIR": profile}
        with mock.patch.dict(os.environ, world | (other_arithmetic() if arithmetic == "other" else {})):
            result = single_nb_execution(notebook_of(page), str(page.parent), timeout=_LONGEST, allow_errors=False)
        records = [json.loads(line) for line in told.read_text(encoding="utf-8").splitlines()] if told.exists() else []
    record = {
        "claims": [r for r in records if "claim" in r],
        "warnings": [r["warning"] for r in records if "warning" in r],
        "error": (result.exc_string or "").strip().rpartition("\n")[2] or None if result.err else None,
        **{"arithmetic": arithmetic, "shift": shift},
    }
    keep.parent.mkdir(parents=True, exist_ok=True)
    with replacing(keep) as file:
        file.write(json.dumps(record).encode())
    outcome = f"{'; '.join(failures(record)) or 'held'} ({time.perf_counter() - began:.0f} s)"
    print(f"{page.stem} {arithmetic} {shift:+d}: {outcome}", flush=True)


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
    options = parser.parse_args()
    known = {page.stem: page for page in pages()}
    wrong = [f"CHAPTERS: there is no {c!r}; there are {', '.join(known)}" for c in options.chapters if c not in known]
    if "FMSYNC_SEED_SHIFT" in os.environ:
        wrong.append("FMSYNC_SEED_SHIFT: is set by this command; unset it, and choose --seed")
    if wrong:
        print(wrong[0], file=sys.stderr)
        return 2
    chosen = {c: p for c, p in known.items() if not options.chapters or c in options.chapters}
    worlds = [(a, s) for s in shifts(options.seed) for a in ("native", "other")]
    columns = [f"{a} {s:+d}" for a, s in worlds]
    folder = ROOT / "_build" / "worlds" / cache_folder().name
    tasks = {}
    for chapter, page in chosen.items():
        stem = f"{chapter}-{sha256(page.read_bytes()).hexdigest()[:12]}"
        tasks[chapter] = [(page, a, s, folder / f"{stem}-{a}-{s}.json") for a, s in worlds]
    left = [task for own in tasks.values() for task in own if not task[-1].is_file()]
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        list(pool.map(run, *zip(*left)))
    failed, table = [], {}
    for chapter, runs in tasks.items():
        own = [json.loads(keep.read_text(encoding="utf-8")) for *_, keep in runs]
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
