"""Files that once did harm, and a few mutants of each kind: an answer or a ValueError, nothing else."""

import contextlib
import warnings

import pytest

from tests import fuzz


@pytest.mark.parametrize("path", sorted(fuzz.BROKEN.iterdir()), ids=lambda path: path.name)
def test_files_that_did_harm(path):
    reader, _ = fuzz.good_files()[path.suffix]
    with warnings.catch_warnings(), contextlib.suppress(ValueError):
        warnings.simplefilter("ignore")
        reader(path)


@pytest.mark.parametrize("suffix", fuzz.good_files())
def test_good_files_are_read_and_mutants_do_no_harm(suffix, tmp_path):
    reader, good = fuzz.good_files()[suffix]
    for k, data in enumerate(good):
        path = tmp_path / f"good{k}{suffix}"
        path.write_bytes(data)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader(path)
    assert fuzz.fuzz(suffix, 40) == {}
