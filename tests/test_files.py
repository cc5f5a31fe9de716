"""Files appear whole or not at all."""

import pytest

from fmsync.files import replacing


def test_a_file_takes_its_place_at_the_end(tmp_path):
    path = tmp_path / "answer"
    path.write_text("41")
    with replacing(path) as file:
        file.write(b"42")
        assert path.read_text() == "41"
    assert path.read_text() == "42"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_nothing_half_written_stays(tmp_path, error):
    def fail():
        with replacing(tmp_path / "answer") as file:
            file.write(b"4")
            raise error

    with pytest.raises(error):
        fail()
    assert not list(tmp_path.iterdir())
