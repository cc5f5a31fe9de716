"""Problems survive a round trip through a file bit for bit, and half a file is no problem."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import data_gen
import fmsync


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 6), st.integers(2, 5), st.floats(0, 2), st.booleans(), st.integers(0, 99))
def test_round_trip_is_exact(tmp_path_factory, n_nodes, n, sigma2, two_way, seed):
    p = data_gen.perturb(data_gen.planted(n_nodes, n, rng=seed), sigma2, seed, two_way=two_way)
    path = tmp_path_factory.mktemp("problem") / "p.npz"
    same = fmsync.load_problem(fmsync.save_problem(p, path))
    assert same.n_nodes == p.n_nodes
    for name in ("edges", "maps", "weights"):
        assert getattr(same, name).tobytes() == getattr(p, name).tobytes()
    assert same.provenance == p.provenance
    assert [file.name for file in path.parent.iterdir()] == ["p.npz"]


def test_weights_and_a_generator_state_come_back(tmp_path):
    p = data_gen.perturb(data_gen.planted(3, 3), 0.1, np.random.default_rng(4))
    p = fmsync.SyncProblem(3, p.edges, p.maps, [0.5, 1.0, 2.0], p.provenance)
    same = fmsync.load_problem(fmsync.save_problem(p, tmp_path / "weighted"))
    np.testing.assert_array_equal(same.weights, [0.5, 1.0, 2.0])
    assert same.provenance["rng"]["bit_generator"] == "PCG64"


def test_a_failed_write_leaves_nothing(tmp_path):
    p = fmsync.SyncProblem(2, [[0, 1]], np.eye(3)[None], provenance={"odd": object()})
    with pytest.raises(TypeError):
        fmsync.save_problem(p, tmp_path / "p.npz")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x03\x04 cut"])
def test_broken_files_are_named(tmp_path, content):
    path = tmp_path / "broken.npz"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"broken\.npz"):
        fmsync.load_problem(path)


def test_a_truncated_file_is_named(tmp_path):
    path = fmsync.save_problem(data_gen.perturb(data_gen.planted(4, 5), 0.1), tmp_path / "cut.npz")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ValueError, match=r"cut\.npz"):
        fmsync.load_problem(path)
