"""``python -m bench``: run, collect, report, compare, verify, list."""

import argparse
import itertools
import os
import sys
import time
from pathlib import Path

from tqdm import tqdm

from fmsync.extras import MissingExtra, require_all

_STORE = Path(os.environ.get("FMSYNC_BENCH_STORE", ".bench"))
_RESULTS = Path("results")
NEEDED = (  # by some command or suite: what is missing is reported before a run begins
    "autograd",
    "distributed",
    "geomstats",
    "joblib",
    "matplotlib",
    "pandas",
    "potpourri3d",
    "pyFM",
    "pyarrow",
    "pymanopt",
    "pyvista",
    "robust_laplacian",
    "sklearn",
)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; bad input, or an extra that is missing, ends with one line and status 2.

    Examples
    --------
    >>> from bench.__main__ import main
    >>> main(["compare", "missing.parquet", "missing.parquet"])
    2
    """
    parsed = _parser().parse_args(arguments)
    try:
        require_all("bench", "bench", *NEEDED)
        return parsed.run(parsed)
    except (ValueError, MissingExtra) as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m bench", description="Run and compare benchmark suites.")
    actions = parser.add_subparsers(required=True, metavar="COMMAND")

    run = _command(
        actions,
        "run",
        "run the cells of a suite that are not finished yet, and write its table of results",
        "python -m bench run smoke\n  python -m bench run paper --seeds 3 --jobs 2\n"
        "  python -m bench run smoke --with my_method.py\n  python -m bench run paper --backend dask --scheduler tcp://127.0.0.1:8786",
    )
    run.add_argument("suite", help="name of a suite, or a .toml file")
    run.add_argument("--seeds", type=int, help="at most so many seeds, to begin with")
    run.add_argument("--only", metavar="REGEX", help="only cells whose description matches; writes no results")
    run.add_argument(
        "--with", dest="files", action="append", default=[], metavar="FILE", help="file that adds a method"
    )
    run.add_argument(
        "--jobs", type=int, default=os.cpu_count(), help="processes, one BLAS thread each (default: cores)"
    )
    run.add_argument("--backend", choices=("loky", "dask"), default="loky", help="processes here, or a Dask cluster")
    run.add_argument("--scheduler", metavar="ADDRESS", help="of the Dask cluster, such as tcp://127.0.0.1:8786")
    run.add_argument("--store", type=Path, default=_STORE, help="folder of finished cells (default: %(default)s)")
    run.add_argument("--results", type=Path, help=f"folder of the tables of results (default: {_RESULTS})")
    run.set_defaults(run=_run)

    collect = _command(
        actions,
        "collect",
        "write the table of results of the cells that are finished so far, without running any",
        "python -m bench collect paper",
    )
    collect.add_argument("suite", help="name of a suite, or a .toml file")
    collect.add_argument("--store", type=Path, default=_STORE, help="folder of finished cells (default: %(default)s)")
    collect.add_argument("--results", type=Path, default=_RESULTS, help="default: %(default)s")
    collect.set_defaults(run=_collect)

    report = _command(
        actions,
        "report",
        "print the tables of a suite and draw its figures",
        "python -m bench report\n  python -m bench report scale",
    )
    report.add_argument("suite", nargs="?", default="paper", help="default: %(default)s")
    report.add_argument("--results", type=Path, default=_RESULTS, help="default: %(default)s")
    report.add_argument("--figures", type=Path, help="also draw the figures into this folder")
    report.set_defaults(run=_report)

    compare = _command(
        actions,
        "compare",
        "what got better or worse between two tables of results; exit status 1 when something got worse",
        "python -m bench compare old/smoke.parquet results/smoke.parquet",
    )
    compare.add_argument("before", type=Path)
    compare.add_argument("after", type=Path)
    compare.add_argument(
        "--tolerance", type=float, default=0.01, help="relative change to report (default: %(default)s)"
    )
    compare.set_defaults(run=_compare)

    verify = _command(
        actions,
        "verify",
        "run random cells of the tables of results again and compare; exit status 1 when one differs",
        "python -m bench verify\n  python -m bench verify paper robust --cells 20 --seed 1",
    )
    verify.add_argument("suites", nargs="*", metavar="SUITE", help="default: all that have a table of results")
    verify.add_argument("--cells", type=int, default=10, help="how many, of all tables together (default: %(default)s)")
    verify.add_argument("--seed", type=int, default=0, help="chooses the cells (default: %(default)s)")
    verify.add_argument(
        "--replicas",
        type=int,
        default=16,
        help="repetitions of a cell that is outside of the tolerance, to see how much it varies (default: %(default)s)",
    )
    verify.add_argument("--results", type=Path, default=_RESULTS, help="default: %(default)s")
    verify.set_defaults(run=_verify)

    listing = _command(actions, "list", "suites and methods", "python -m bench list")
    listing.set_defaults(run=_list)
    return parser


def _command(actions, name: str, text: str, example: str) -> argparse.ArgumentParser:
    return actions.add_parser(
        name,
        help=text,
        description=text,
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _run(arguments: argparse.Namespace) -> int:
    from bench.results import to_frame, write
    from bench.runner import RunError, run_cells
    from bench.store import Store
    from bench.suites import load_suite

    if (arguments.backend == "dask") != (arguments.scheduler is not None):
        raise ValueError("scheduler: --backend dask and --scheduler ADDRESS go together")
    began = time.perf_counter()
    suite = load_suite(arguments.suite, files=arguments.files, seeds=arguments.seeds, only=arguments.only)
    print(f"{suite.name}: {len(suite.cells)} cells. {suite.description}")
    progress = _Progress()
    try:
        run = run_cells(
            suite.cells,
            Store(arguments.store),
            n_jobs=arguments.jobs,
            scheduler=arguments.scheduler,
            on_record=progress.record,
            on_start=progress.start,
        )
    except KeyboardInterrupt:
        progress.close()
        print("stopped; the finished cells are kept, run again to go on", file=sys.stderr)
        return 130
    except RunError as error:
        progress.close()
        print(f"bench: {error}", file=sys.stderr)
        return 3
    progress.close()
    for message in run.corrupt:
        print(message)
    failed = [record for record in run.records if record["status"] != "ok"]
    print(
        f"{len(run.records) - len(failed)} finished ({run.n_cached} of them before), {len(failed)} failed, "
        f"{time.perf_counter() - began:.1f} s"
    )
    for record in failed[:10]:
        last = (record.get("traceback") or "").strip().rpartition("\n")[2]
        print(f"  {record['status']}: {record['label']} {record['problem']} seed {record['seed']}: {last}")
    if arguments.only is None or arguments.results is not None:
        path = (arguments.results or _RESULTS) / f"{suite.name}.parquet"
        write(to_frame(suite.name, run.records), path)
        print(f"wrote {path}")
    return 1 if failed else 0


def _collect(arguments: argparse.Namespace) -> int:
    from bench.results import to_frame, write
    from bench.store import Store
    from bench.suites import load_suite

    suite, store = load_suite(arguments.suite), Store(arguments.store)
    found = [(cell, store.read(cell.key) or store.failure(cell.key)) for cell in suite.cells]
    records = [{**record, "label": cell.label} for cell, record in found if record is not None]
    if not records:
        raise ValueError(
            f"{arguments.store}: no cell of {suite.name} is finished; run 'python -m bench run {suite.name}'"
        )
    path = arguments.results / f"{suite.name}.parquet"
    write(to_frame(suite.name, records), path)
    print(f"{len(records)} of {len(suite.cells)} cells; wrote {path}")
    return 0


class _Progress:
    """A bar with the time left on a terminal, a line for every cell elsewhere."""

    def __init__(self):
        self._bar, self._n_left, self._n_done = None, 0, 0

    def start(self, n_cached: int, n_left: int) -> None:
        self._n_left = n_left
        if n_cached:
            print(f"{n_cached} cells are finished already, {n_left} are left")
        if n_left and sys.stderr.isatty():
            self._bar = tqdm(total=n_left, unit="cell")

    def record(self, cell, record: dict) -> None:
        self._n_done += 1
        if self._bar is not None:
            self._bar.update()
            if record["status"] != "ok":
                self._bar.write(f"{record['status']}: {cell}")
        else:
            print(f"{self._n_done}/{self._n_left} {record['status']} {record['wall']:.2f} s {cell}", flush=True)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


def _report(arguments: argparse.Namespace) -> int:
    from bench import results
    from bench.report import draw_figures, report

    frame = results.read(arguments.results / f"{arguments.suite}.parquet")
    print(report(frame))
    if arguments.figures is not None:
        for path in draw_figures(frame, arguments.figures):
            print(f"wrote {path}")
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    from bench import results

    found = results.compare(results.read(arguments.before), results.read(arguments.after), arguments.tolerance)
    if found.empty:
        print("no difference beyond chance and tolerance")
        return 0
    print(found.to_string(index=False, float_format="{:.4g}".format))
    regressions = ~found.verdict.isin(["better"]) & ~found.verdict.str.endswith("-> ok")
    return 1 if regressions.any() else 0


def _verify(arguments: argparse.Namespace) -> int:
    import pandas as pd

    from bench import results
    from bench.runner import current_commit
    from bench.verify import RULES, agrees, verify

    names = arguments.suites or sorted(path.stem for path in arguments.results.glob("*.parquet"))
    if not names:
        raise ValueError(f"{arguments.results}: no tables of results there; name another folder with --results")
    frame = pd.concat([results.read(arguments.results / f"{name}.parquet") for name in names], ignore_index=True)
    made = ", ".join(sorted(frame.commit.unique()))
    print(f"{arguments.cells} random cells of {', '.join(names)}; made at {made}, run again at {current_commit()}")
    compared = verify(frame, arguments.cells, arguments.seed, n_replicas=arguments.replicas)
    everything, reasons = [], set()
    for cell, found in itertools.groupby(compared, lambda one: one.cell):
        verdicts = list(found)
        for reason in sorted({one.reason for one in verdicts} - reasons - {""}):
            print(f"rows {reason}; bits need not be equal")
            reasons.add(reason)
        print(f"{cell}: {_counts(verdicts, RULES)}", flush=True)
        for one in verdicts:
            if one.metric == "edge_error" or not agrees(one):
                numbers = f"{one.before:.6g} then, {one.now:.6g} now, {one.interval:.2g} allowed"
                print(f"  {one.verdict} ({one.rule}): {one.metric} {numbers}")
        everything += verdicts
    n_doubtful = sum(not agrees(one) for one in everything)
    print(f"{f'{n_doubtful} metrics differ' if n_doubtful else 'all agree'}; compared: {_counts(everything, RULES)}")
    return 1 if n_doubtful else 0


def _counts(verdicts, rules) -> str:
    """How many metrics were compared by which rule, and how many have equal bits though that was not demanded."""
    told = []
    for rule in rules:
        those = [one.verdict for one in verdicts if one.rule == rule]
        equal = f" ({those.count('equal')} in all bits)" if rule == "tolerance" else ""
        told += [f"{len(those)} by {rule}{equal}"] if those else []
    return ", ".join(told)


def _list(arguments: argparse.Namespace) -> int:
    import tomllib

    from bench import methods, suites

    for name in suites.suite_names():
        print(f"{name:14s} {tomllib.loads(suites.suite_file(name).read_text(encoding='utf-8'))['description']}")
    print("\nmethods: " + ", ".join(methods.names()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
