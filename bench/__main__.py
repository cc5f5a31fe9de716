"""``python -m bench``: run, report, compare, verify, list."""

import argparse
import itertools
import os
import sys
import time
import tomllib
from pathlib import Path

from tqdm import tqdm

from fmsync.cli import add_commands
from fmsync.extras import MissingExtra, require_all

NEEDED = (  # by some command or suite: what is missing is reported before a run begins
    *("autograd", "distributed", "geomstats", "joblib", "matplotlib", "pandas", "potpourri3d", "pyFM"),
    *("pyarrow", "pymanopt", "pyvista", "sklearn"),
)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; bad input, an extra that is missing or a full disk ends with one line and status 2."""
    parser = argparse.ArgumentParser(prog="python -m bench", description="Run and compare benchmark suites.")
    runs = {"run": _run, "report": _report, "compare": _compare, "verify": _verify, "list": _list}
    cache = Path(os.environ.get("FMSYNC_BENCH_CACHE", ".bench"))
    add_commands(parser, Path(__file__).with_name("help.toml"), runs, jobs=os.cpu_count(), cache=cache)
    parsed = parser.parse_args(arguments)
    try:
        require_all("bench", "bench", *NEEDED)
        return parsed.run(parsed)
    except (ValueError, MissingExtra) as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("stopped; the finished runs are kept, run again to go on", file=sys.stderr)
        return 130


def _run(arguments: argparse.Namespace) -> int:
    from bench import results
    from bench.cache import ResultCache
    from bench.runner import run_suite
    from bench.suites import load_suite

    if (arguments.backend == "dask") != (arguments.scheduler is not None):
        raise ValueError("scheduler: --backend dask and --scheduler ADDRESS go together")
    began = time.perf_counter()
    suite = load_suite(arguments.suite, files=arguments.files, seeds=arguments.seeds, only=arguments.only)
    print(f"{suite.name}: {len(suite.runs)} runs. {suite.description}")
    bar, number = tqdm(unit="run", disable=not sys.stderr.isatty()), itertools.count(1)

    def on_start(n_cached: int, n_left: int) -> None:
        bar.reset(total=n_left)
        if n_cached:
            print(f"{n_cached} runs are finished already, {n_left} are left")

    def on_record(run: object, record: dict) -> None:
        bar.update()
        if bar.disable:
            print(f"{next(number)}/{bar.total} {record['status']} {record['wall']:.2f} s {run}", flush=True)
        elif record["status"] != "ok":
            bar.write(f"{record['status']}: {run}")

    with bar:
        options = {"n_jobs": arguments.jobs, "scheduler": arguments.scheduler}
        options |= {"on_start": on_start, "on_record": on_record}
        outcome = run_suite(suite.runs, ResultCache(arguments.cache), **options)
    print(*outcome.corrupt, sep="\n", end="\n" * bool(outcome.corrupt))
    failed = [record for record in outcome.records if record["status"] != "ok"]
    finished, seconds = len(outcome.records) - len(failed), time.perf_counter() - began
    print(f"{finished} finished ({outcome.n_cached} of them before), {len(failed)} failed, {seconds:.1f} s")
    for record in failed[:10]:
        last = record["traceback"].strip().rpartition("\n")[2]
        print(f"  {record['status']}: {record['label']} {record['problem']} seed {record['seed']}: {last}")
    if arguments.only is None or arguments.results is not None:
        path = (arguments.results or Path("results")) / f"{suite.name}.parquet"
        results.write(results.to_frame(suite.name, outcome.records), path)
        print(f"wrote {path}")
    return 1 if failed else 0


def _report(arguments: argparse.Namespace) -> int:
    from bench import results
    from bench.report import report

    print(report(results.read(arguments.results / f"{arguments.suite}.parquet")))
    return 0


def _compare(arguments: argparse.Namespace) -> int:
    from bench import results

    found = results.compare(results.read(arguments.before), results.read(arguments.after), arguments.tolerance)
    shown = found.to_string(index=False, float_format="{:.4g}".format)
    print("no difference beyond chance and tolerance" if found.empty else shown)
    return 0 if found.verdict.map(lambda verdict: verdict == "better" or verdict.endswith("-> ok")).all() else 1


def _verify(arguments: argparse.Namespace) -> int:
    import pandas as pd

    from bench import results
    from bench.provenance import current_commit
    from bench.verify import verify

    names = arguments.suites or sorted(path.stem for path in arguments.results.glob("*.parquet"))
    if not names:
        raise ValueError(f"{arguments.results}: no tables of results there; name another folder with --results")
    frame = pd.concat([results.read(arguments.results / f"{name}.parquet") for name in names], ignore_index=True)
    made = ", ".join(sorted(frame.commit.unique()))
    print(f"{arguments.runs} random runs of {', '.join(names)}; made at {made}, repeated at {current_commit()}")
    compared = verify(frame, arguments.runs, arguments.seed, n_replicas=arguments.replicas)
    everything: list = []
    for run, found in itertools.groupby(compared, lambda one: one.run):
        verdicts = list(found)
        for reason in sorted({one.reason for one in verdicts} - {"", *(one.reason for one in everything)}):
            print(f"rows {reason}; bits need not be equal")
        print(f"{run}: {_counts(verdicts)}", flush=True)
        for one in verdicts:
            if one.metric == "edge_error" or not one.agrees:
                numbers = f"{one.before:.6g} then, {one.now:.6g} now, {one.interval:.2g} allowed"
                print(f"  {one.verdict} ({one.rule}): {one.metric} {numbers}")
        everything += verdicts
    n_doubtful = sum(not one.agrees for one in everything)
    print(f"{f'{n_doubtful} metrics differ' if n_doubtful else 'all agree'}; compared: {_counts(everything)}")
    return 1 if n_doubtful else 0


def _counts(verdicts) -> str:
    """How many metrics were compared by which rule, and how many have equal bits though that was not demanded."""
    from bench.verify import RULES

    counts = {rule: [one.verdict for one in verdicts if one.rule == rule] for rule in RULES}
    equal = f" ({counts['tolerance'].count('equal')} in all bits)"
    return ", ".join(f"{len(v)} by {rule}{equal * (rule == 'tolerance')}" for rule, v in counts.items() if v)


def _list(arguments: argparse.Namespace) -> int:
    from bench import methods, suites

    for name in suites.suite_names():
        print(f"{name:14s} {tomllib.loads(suites.suite_file(name).read_text(encoding='utf-8'))['description']}")
    print("\nmethods: " + ", ".join(methods.names()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
