"""``fmsync solve``, ``sample`` and ``info``: what they write and say, and how they end."""

import json
import os

import networkx as nx
import numpy as np
import pytest

import data_gen
import fmsync
from fmsync import adapters, so
from fmsync.cli import main
from tests.surfaces import icosphere, potato


@pytest.fixture(scope="module")
def problem():
    return data_gen.perturb(data_gen.planted(6, 4, rng=0), sigma2=0.02, rng=1)


@pytest.fixture
def file(problem, tmp_path):
    return fmsync.save_problem(problem, tmp_path / "problem.npz")


def run(capsys, *arguments):
    status = main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    return status, said.out, said.err


def write_mesh(path, vertices, faces=None):
    adapters.to_meshio(fmsync.Shape(vertices, faces)).write(path)
    return path


def test_solve_writes_what_the_library_answers(problem, file, tmp_path, capsys):
    out = tmp_path / "maps.npz"
    status, text, error = run(capsys, "solve", file, "-o", out, "--json")
    told, ours = json.loads(text), fmsync.solve(problem)
    assert (status, error, told["certified"], told["warnings"]) == (0, "", True, [])
    assert told["cost"] == ours.cost
    with np.load(out) as arrays:
        np.testing.assert_array_equal(arrays["relative"], ours.relative())
        np.testing.assert_array_equal(arrays["edges"], problem.edges)
        assert arrays["absolute"].shape == (6, 4, 4)
    status, text, _ = run(capsys, "solve", file, "-o", out, "--method", "robust", "--restarts", "2")
    assert (status, "certified" in text, "2 of 2" in text) == (0, True, True)
    with np.load(out) as arrays:
        assert arrays["edge_weights"].shape == (15,)


def test_sample_writes_draws_and_says_what_is_thin(problem, file, tmp_path, capsys):
    out = tmp_path / "draws.npz"
    few = ("--chains", "2", "--draws", "3", "--warmup", "5", "--seed", "3")
    status, text, error = run(capsys, "sample", file, "-o", out, *few, "--json")
    told = json.loads(text)
    assert (status, told["r_hat"], told["chains"]) == (0, None, 2)  # three draws tell nothing, and JSON has no NaN
    with np.load(out) as arrays:
        assert arrays["absolute"].shape == (2, 3, 6, 4, 4)
        assert np.isclose(arrays["kappa"].mean(), told["kappa"])
        assert arrays["relative_mean"].shape == (15, 4, 4)
    status, _, error = run(capsys, "sample", file, "-o", out, "--chains", "2", "--draws", "20", "--warmup", "5")
    (line,) = [line for line in error.splitlines() if "effective draws of" in line]  # after R-hat, if it is large too
    assert (status, line.startswith("fmsync: warning: "), "warnings.warn" in error) == (0, True, False)


def test_mistakes_end_in_one_line_with_status_two_and_nothing_written(file, tmp_path, capsys):
    out = tmp_path / "out.npz"
    torn = tmp_path / "torn.npz"
    torn.write_bytes(file.read_bytes()[:200])
    for wrong, words in (
        (("solve", file, "-o", out, "--method", "mel"), "did you mean mle"),
        (("solve", file, "-o", out, "--restarts", "0"), "restarts"),
        (("solve", file, "-o", out, "--seed", "-1"), "--seed"),
        (("solve", file, "-o", file), "it is the problem"),
        (("solve", file, "-o", tmp_path / "no" / "out.npz"), "in a folder that is there"),
        (("sample", file, "-o", tmp_path / "out.csv"), "ends in .npz"),
        (("sample", file, "-o", out, "--draws", "0"), "n_draws"),
        (("sample", file, "-o", out, "--method", "rlfm", "--likelihood", "projected-gaussian"), "likelihood"),
        (("sample", torn, "-o", out), "torn.npz: not a complete problem file"),
        (("sample", tmp_path / "gone.npz", "-o", out), "gone.npz: there is no such file"),
        (("info", tmp_path / "gone"), "there is no such file or folder"),
    ):
        status, text, error = run(capsys, *wrong)
        assert (status, text, error.count("\n")) == (2, "", 1), wrong
        assert words in error
    assert sorted(os.listdir(tmp_path)) == ["problem.npz", "torn.npz"]
    with pytest.raises(SystemExit, match="2"):
        main(["solve", str(file)])


@pytest.mark.parametrize(("error", "status"), [(KeyboardInterrupt, 130), (RuntimeError("diverged"), 1), (OSError, 1)])
def test_a_run_that_is_stopped_or_fails_leaves_nothing(error, status, file, tmp_path, capsys, monkeypatch):
    def fails(*arguments, **options):
        raise error

    monkeypatch.setattr(fmsync, "sample", fails)
    ended, _, said = run(capsys, "sample", file, "-o", tmp_path / "out.npz")
    assert (ended, said.count("\n"), os.listdir(tmp_path)) == (status, 1, ["problem.npz"])
    if status == 130:
        assert "nothing was written" in said


@pytest.mark.parametrize("command", ["sync", "solve", "sample", "info"])
def test_help_shows_examples_and_exit_statuses(command, capsys):
    with pytest.raises(SystemExit, match="0"):
        main([command, "--help"])
    told = capsys.readouterr().out
    assert all(words in told for words in ("examples:", f"fmsync {command} ", "exit status: 0", "--json"))


def test_info_guesses_the_noise_of_a_problem(tmp_path, capsys):
    kappa = 60.0
    truth = data_gen.planted(12, 6, rng=0)
    problem = data_gen.perturb(truth, kappa=kappa, noise="langevin", rng=1)
    status, text, _ = run(capsys, "info", fmsync.save_problem(problem, tmp_path / "p"), "--json")
    (told,) = json.loads(text)["files"]
    assert (status, told["shapes"], told["observations"], told["cycles"], told["bipartite"]) == (0, 12, 66, 55, False)
    # the mean of 55 d chi-squared terms of one degree of freedom each, d = 15: standard error 5 %
    assert abs(told["kappa"] / kappa - 1) < 5 * np.sqrt(2 / (55 * 15)) + 0.05
    assert told["recoverable"]
    assert told["bound_holds"]
    expected = fmsync.bounds.langevin_error_bound(12, problem.edges, 6, told["kappa"])
    assert told["rms_error_bound"] == pytest.approx(np.sqrt(expected.mean()))
    assert told["sample_seconds"] > 0


def test_info_says_when_noise_hides_the_maps_or_cannot_be_seen(tmp_path, capsys):
    noise = fmsync.SyncProblem(6, list(nx.complete_graph(6).edges), so.random_uniform(8, 15, rng=0))
    tree = fmsync.SyncProblem(3, [[0, 1], [1, 2]], so.random_uniform(4, 2, rng=0))
    for name, problem in (("noise", noise), ("tree", tree)):
        fmsync.save_problem(problem, tmp_path / name)
    (tmp_path / "other.npz").write_bytes(b"no problem")
    status, text, _ = run(capsys, "info", tmp_path, "--json")
    told = json.loads(text)
    first, other, second = told["files"]
    assert (status, first["recoverable"], second["cycles"], second["bipartite"]) == (2, False, 0, True)
    assert "give sample --kappa" in second["noise"]
    assert "not a complete problem file" in other["refused"]
    assert told["would_run"] == ["fmsync solve, fmsync sample: each problem on its own"]


def test_info_tells_what_a_mesh_is_like(tmp_path, capsys):
    vertices, faces = potato(2)
    write_mesh(tmp_path / "a_closed.obj", vertices, faces)
    write_mesh(tmp_path / "b_ball.obj", *icosphere(2))
    unused = np.unique(faces[:-40], return_inverse=True)
    write_mesh(tmp_path / "c_open.obj", vertices[unused[0]], unused[1].reshape(-1, 3))
    twice = np.concatenate([vertices, vertices + 9])
    write_mesh(tmp_path / "d_two.obj", twice, np.concatenate([faces, faces + len(vertices)]))
    text = (tmp_path / "a_closed.obj").read_text()
    (tmp_path / "e_idle.obj").write_text(text + "v 9 9 9\n")
    status, out, _ = run(capsys, "info", tmp_path, "--json")
    closed, ball, opened, two, idle = json.loads(out)["files"]
    assert (status, closed["vertices"], closed["faces"], closed["closed"]) == (2, 162, 320, True)
    assert (closed["surface_of_revolution"], ball["surface_of_revolution"]) == (False, True)
    assert not opened["closed"]
    assert opened["boundary_edges"] > 0
    assert "2 components" in two["refused"]
    assert "1 vertices are on no face" in idle["repaired"]
    assert json.loads(out)["would_run"] == ["fmsync sync: 4 shapes, 6 pairs"]
    status, out, _ = run(capsys, "info", tmp_path / "a_closed.obj")
    assert (status, "closed" in out, "fmsync sync" in out) == (0, True, False)
