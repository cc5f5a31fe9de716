"""Suite files: what is read, what is swept, and how mistakes are named."""

import pytest

from bench.runner import execute
from bench.suites import Run, load_suite, suite_names
from data_gen import load_collection

GOOD = """description = "a test"
seeds = 2
seconds = 5

[method.quick]
use = "rlfm"
n_draws = 10

[[grid]]
generator = "bench.problems:rotations"
problem = { n_nodes = [4, 5], n = 3, sigma2 = [0.1, 0.2, 0.3] }
methods = ["spectral", "quick"]
"""


@pytest.fixture
def suite(tmp_path):
    def write(text):
        path = tmp_path / "test.toml"
        path.write_text(text)
        return path

    return write


def test_lists_are_swept_and_seeds_are_paired(suite):
    runs = load_suite(suite(GOOD)).runs
    assert len(runs) == 2 * 3 * 2 * 2
    assert len({run.key for run in runs}) == len(runs)
    by_label = {
        label: [(run.problem, run.seed) for run in runs if run.label == label] for label in ("spectral", "quick")
    }
    assert by_label["spectral"] == by_label["quick"]
    assert runs[1].method == "rlfm"
    assert runs[1].options == {"n_draws": 10}
    assert runs[0].seconds == 5.0


def test_methods_of_another_suite(suite):
    text = GOOD.replace("seeds = 2", 'seeds = 2\nmethods_of = "paper"').replace('"spectral"', '"MC (1)"')
    runs = load_suite(suite(text)).runs
    assert runs[0].method == "rlfm"
    assert runs[0].options["constrained"] is False
    with pytest.raises(ValueError, match="did you mean paper"):
        load_suite(suite(text.replace('methods_of = "paper"', 'methods_of = "papers"')))


def test_seeds_and_only(suite):
    path = suite(GOOD)
    assert len(load_suite(path, seeds=1).runs) == 12
    assert len(load_suite(path, only=r"^quick .*n_nodes=4").runs) == 6
    with pytest.raises(ValueError, match="no run"):
        load_suite(path, only="nothing")
    with pytest.raises(ValueError, match="regular expression"):
        load_suite(path, only="(")
    with pytest.raises(ValueError, match="seeds"):
        load_suite(path, seeds=0)


def test_the_address_depends_on_what_runs_and_not_on_its_name_or_limits(suite):
    runs = load_suite(suite(GOOD)).runs
    renamed = load_suite(suite(GOOD.replace("quick", "fast").replace("seconds = 5", "seconds = 9"))).runs
    assert [run.key for run in renamed] == [run.key for run in runs]
    changed = load_suite(suite(GOOD.replace("n_draws = 10", "n_draws = 11"))).runs
    same = [a.key == b.key for a, b in zip(runs, changed)]
    assert same == [run.label == "spectral" for run in runs]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seconds = 5", "secnods = 5", "line 3: .*secnods.*seconds"),
        ("generator =", "generater =", "line 10: .*generater.*generator"),
        ("n_draws = 10", "n_drwas = 10", "line 7: .*n_drwas.*n_draws"),
        ("sigma2", "sigma", "line 11: .*'sigma'.*sigma2"),
        ('"spectral"', '"spectrall"', "line 12: .*spectrall.*spectral"),
        ('use = "rlfm"', 'use = "rlmf"', "line 6: .*rlmf.*rlfm"),
        (":rotations", ":rotation", "line 10: .*rotation"),
        ("bench.problems", "data_gen.nowhere", "line 10: .*nowhere"),
        ("seeds = 2", 'seeds = "2"', "line 2: seeds"),
        ("seeds = 2", "seeds = 0", "line 2: seeds must be > 0"),
        ("seeds = 2", "", "seeds is missing"),
        ('description = "a test"', "", "description is missing"),
        ("problem = {", "problem = [", "line 11"),
    ],
)
def test_mistakes_are_named_with_their_line(suite, old, new, message):
    with pytest.raises(ValueError, match=message):
        load_suite(suite(GOOD.replace(old, new, 1)))


def test_unknown_suite_offers_near_ones():
    with pytest.raises(ValueError, match="did you mean smoke"):
        load_suite("smok")


@pytest.mark.parametrize("name", suite_names())
def test_suites_of_the_package_are_sound(name):
    assert load_suite(name, seeds=1).runs


@pytest.fixture
def collection(tmp_path, monkeypatch):
    """A folder of collections with one of two cats in it."""
    folder = tmp_path / "data" / "kittens"
    folder.mkdir(parents=True)
    for shape in load_collection("cats", count=2, n_vertices=1000):
        rows = [" ".join(map(repr, row)) for row in shape.vertices.tolist()]
        rows += [" ".join(map(str, [3, *row])) for row in shape.faces.tolist()]
        head = ["OFF", f"{shape.n_vertices} {len(shape.faces)} 0"]
        (folder / f"{shape.name}.off").write_text("\n".join(head + rows))
    monkeypatch.setenv("FMSYNC_DATA", str(tmp_path / "data"))
    return folder


def test_changed_data_never_meet_an_old_result(collection):
    problem = {"n_nodes": 2, "n": 4, "collection": "kittens", "sigma2": 0.1}

    def run():
        return Run("bench.problems:shapes", problem, 0, "mle", "mle")

    before, error = run().key, execute(run())["metrics"][3]
    file = collection / "cat1.off"
    file.write_bytes(file.read_bytes())  # newer, the same bytes
    assert run().key == before
    lines = file.read_text().splitlines()
    lines[2] = "0.5 0.5 0.5"  # one vertex somewhere else
    file.write_text("\n".join(lines))
    assert run().key != before
    changed = execute(run())["metrics"][3]
    assert error[0] == changed[0] == "edge_error"
    assert error[2] != changed[2]  # nor does the process remember the old shapes


def test_another_collection_takes_the_place_of_the_cats(collection):
    runs = load_suite("meshes@kittens", seeds=1).runs
    assert {run.problem["collection"] for run in runs} == {"kittens"}
    assert len(runs) == len(load_suite("meshes", seeds=1).runs)
    with pytest.raises(ValueError, match="nothere.*FMSYNC_DATA"):
        load_suite("meshes@nothere")
    with pytest.raises(ValueError, match="no grid names a collection"):
        load_suite("robust@kittens")
    with pytest.raises(ValueError, match="not a name"):
        load_suite("meshes@some/where")
