"""The command line, and the smoke suite from run to report."""

import io
import re
import sys
import time

import pytest

from bench import results
from bench.__main__ import main
from tests.bench.helpers import TRICKS


def test_smoke_suite_runs_is_cached_and_reports(tmp_path, capsys):
    """The benchmark works on this machine; within a minute when nobody else wants it."""
    places = ["--cache", str(tmp_path / "cache"), "--results", str(tmp_path)]
    assert main(["run", "smoke", "--jobs", "1", *places]) == 0
    first = capsys.readouterr().out
    assert " 0 failed" in first
    frame = results.read(tmp_path / "smoke.parquet")
    assert (frame.status == "ok").all()
    error = frame[frame.metric == "edge_error"].groupby("label").value.mean()
    assert error["oracle"] == 0.0
    assert error["mle"] < error["observed"] < error["random"]
    far = frame[(frame.metric == "pair_rms") & (frame.label == "random")].value
    assert abs((far**2).mean() - 12) < 2.5  # 2 n: it knows nothing
    assert error["mle"] <= error["spectral"] * 1.02
    point = frame[frame.metric == "point_error"].groupby("label").value.mean()
    assert point["oracle"] < point["mle"] < point["identity"]

    began = time.perf_counter()
    assert main(["run", "smoke", "--jobs", "1", *places]) == 0
    assert time.perf_counter() - began < 10
    assert "finished already, 0 are left" in capsys.readouterr().out
    assert main(["report", "smoke", "--results", str(tmp_path)]) == 0
    assert "oracle" in capsys.readouterr().out
    assert main(["compare", str(tmp_path / "smoke.parquet"), str(tmp_path / "smoke.parquet")]) == 0
    assert "no difference" in capsys.readouterr().out


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_with_the_time_left_on_a_terminal_and_lines_elsewhere(tmp_path, monkeypatch, capsys, terminal):
    screen = io.StringIO()
    screen.isatty = lambda: terminal
    monkeypatch.setattr(sys, "stderr", screen)
    chosen = ["--only", "^(spectral|trick-raise) .*n_nodes=6 .*", "--seeds", "1", "--with", TRICKS]
    main(["run", "smoke", *chosen, "--jobs", "1", "--cache", str(tmp_path)])
    out = capsys.readouterr().out
    lines = [line for line in out.splitlines() if re.match(r"\d+/\d+ ", line)]
    if terminal:
        assert re.search(r"(\d+)/\1 \[\d\d:\d\d<00:00", screen.getvalue())  # done/all [so far<left
        assert "error: trick-raise" in out  # failures stay to be read
        assert not lines
    else:
        assert screen.getvalue() == ""
        assert len(lines) >= 2
        assert any(" error " in line for line in lines)


def test_failing_runs_give_status_one_and_their_reason(tmp_path, capsys):
    arguments = ["run", "smoke", "--with", TRICKS, "--only", "^trick-raise .*seed=0", "--seeds", "1"]
    assert main([*arguments, "--cache", str(tmp_path), "--jobs", "1"]) == 1
    assert "RuntimeError: the trick failed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "smok"], "did you mean smoke"),
        (["run", "smoke", "--with", "missing.py"], "no such file"),
        (["run", "smoke", "--backend", "dask"], "--scheduler"),
        (["report", "nothing"], "python -m bench run nothing"),
    ],
)
def test_bad_input_ends_with_one_line(arguments, message, capsys):
    assert main([*arguments]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("command", ["run", "report", "compare", "verify", "list"])
def test_help_shows_an_example(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert f"python -m bench {command}" in capsys.readouterr().out.partition("example:")[2]


def test_list_names_suites_and_methods(capsys):
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    assert "smoke" in out
    assert "spectral" in out
