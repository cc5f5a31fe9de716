"""The same maps when the pairwise stage runs on a Dask cluster that exists already."""

import numpy as np
import pytest
from joblib import parallel_config

import fmsync
from fmsync.matching import samples, synchronize
from tests.matching.conftest import OPTIONS

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.filterwarnings("ignore")


def test_a_cluster_gives_the_maps_of_this_process(cats, tmp_path, monkeypatch):
    here = fmsync.synchronize_shapes(cats[:3], n_draws=0, **OPTIONS)
    monkeypatch.setattr(synchronize, "sample_shape", samples.sample_shape)  # what other processes can import
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    )
    with cluster, distributed.Client(cluster), parallel_config(backend="dask"):
        there = fmsync.synchronize_shapes(cats[:3], n_draws=0, checkpoint=tmp_path, jobs=2, **OPTIONS)
    np.testing.assert_allclose(there.refined, here.refined, atol=1e-9)
    assert len(list(tmp_path.glob("*.npz"))) == 3
