"""The scripts around the book: the archive is the same for the same pages, the status says what the cache knows."""

import base64
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import nbformat
import numpy as np
import pytest
from IPython.core.inputtransformer2 import TransformerManager
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]


def _load(path: str):
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


overview = _load("scripts/draw_gallery.py")
sync_notebooks = _load("scripts/sync_notebooks.py")
book = _load("book/_ext/fmsync_book.py")


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
@pytest.mark.parametrize("date", ["1790000000", "0", ""])
def test_same_pages_same_archive_whatever_their_dates(tmp_path, date):
    html, packed = tmp_path / "_build" / "html", tmp_path / "_build" / "book.zip"

    def pack() -> bytes:
        command = ["make", "-f", ROOT / "Makefile", "-o", "book", "book.zip"]  # the book itself is taken as made
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        env = os.environ | {"PATH": path, "SOURCE_DATE_EPOCH": date}
        subprocess.run(command, cwd=tmp_path, env=env, check=True, capture_output=True)
        return packed.read_bytes()

    for name in ("index.html", "chapters/one.html", ".buildinfo"):
        file = html / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(f"this is {name}")
    first = pack()
    (html / "index.html").touch()
    (html / "chapters" / "one.html").chmod(0o600)
    assert pack() == first
    (html / "index.html").write_text("changed")
    assert pack() != first
    with zipfile.ZipFile(packed) as archive:
        files = [name for name in archive.namelist() if not name.endswith("/")]
        assert files == ["fmsync-book/chapters/one.html", "fmsync-book/index.html"]
        assert archive.read(files[0]) == b"this is chapters/one.html"
    assert [file.name for file in packed.parent.iterdir() if file.name != "html"] == ["book.zip"]


def test_every_chapter_is_in_the_contents_once():
    listed = book.pages()
    written = [page for folder in ("chapters", "how-to") for page in (ROOT / "book" / folder).glob("*.md")]
    assert sorted(listed) == sorted(written)


def test_status_tells_what_ran_and_what_did_not():
    ran, missing = Path("chapters/ran.md"), Path("chapters/missing.md")
    data = {"execution_seconds": 90.2, "cpu_seconds": 60.0, "machine": "a machine", "shapes": "cats", "system": "Linux"}
    lines = book.status_table([ran, missing], {ran: data})
    assert "| {doc}`/chapters/ran` | 90 | 60 | passed |" in lines
    assert "| {doc}`/chapters/missing` | – | – | not run |" in lines
    assert "Together 1.0 CPU-minutes, without the imports that all share." in lines
    assert "- **Machine:** a machine" in lines
    assert any(line.startswith("- **Versions:** fmsync ") for line in lines)


def test_surroundings_name_the_shapes_in_use(monkeypatch, tmp_path):
    monkeypatch.delenv("FMSYNC_DATA", raising=False)
    assert book.surroundings()["shapes"] == "the cats that come with the project"
    (tmp_path / "tosca_cat").mkdir()
    monkeypatch.setenv("FMSYNC_DATA", str(tmp_path))
    assert book.surroundings()["shapes"] == "the TOSCA cats"


def test_pages_offer_to_run_elsewhere_only_with_an_address():
    assert book.launch_links("", "main", "03_mle") == []
    assert book.launch_links("https://example.org/fmsync", "main", "03_mle") == []
    for where, address in book.launch_links("https://github.com/someone/fmsync.git", "main", "03_mle"):
        notebook = address.split("main", 1)[1].split("tree/")[-1].lstrip("/")
        assert (ROOT / notebook).is_file(), where


def test_notebooks_prepare_colab_only_with_an_address(monkeypatch):
    chapter = ROOT / "book" / "chapters" / "03_mle.md"
    plain = nbformat.reads(sync_notebooks.render(chapter), 4)
    monkeypatch.setattr(
        sync_notebooks, "repository", lambda: {"url": "https://github.com/someone/fmsync", "branch": "main"}
    )
    prepared = nbformat.reads(sync_notebooks.render(chapter), 4)
    first, *rest = prepared.cells
    assert "https://github.com/someone/fmsync /content/project" in first.source
    assert [cell.source for cell in rest] == [cell.source for cell in plain.cells]
    code = TransformerManager().transform_cell(first.source)
    exec(code, {})  # away from Colab it must do nothing, not even with a shell
    assert all("colab" not in cell.source for cell in plain.cells)


def test_binder_installs_the_lock_file_and_the_packages_of_the_readme():
    binder = ROOT / ".binder"
    reference = (binder / "requirements.txt").read_text().split()
    assert reference[0] == "-r"
    assert (binder / reference[1]).resolve() == ROOT / "requirements.txt"
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(f" {package} " in readme for package in (binder / "apt.txt").read_text().split())
    version = (binder / "runtime.txt").read_text().strip().removeprefix("python-")
    assert f"--python-version {version} " in (ROOT / "requirements.txt").read_text()
    assert os.access(binder / "postBuild", os.X_OK)


def test_pictures_stay_small():
    gallery = sorted((ROOT / "book" / "images" / "gallery").iterdir())
    page = (ROOT / "book" / "reference" / "gallery.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"gallery/(\w+\.png)", page)) == [picture.name for picture in gallery]
    assert len(gallery) == 6
    assert sum(picture.stat().st_size for picture in gallery) < 1_500_000
    assert min(Image.open(picture).width for picture in gallery) >= 900  # two pixels for one
    explorer = (ROOT / "book" / "images" / "explorer.html").read_text(encoding="utf-8")
    assert len(explorer) < 300_000
    assert "DecompressionStream" not in explorer  # the script comes with the book, once


@pytest.mark.slow
def test_the_explorer_of_the_first_page_has_three_views_at_three_noises():
    shown = overview.explorer(n_vertices=1000, n_draws=20, warmup=20)
    head = json.loads(zlib.decompress(base64.b64decode(shown.data)).partition(b"\n")[0])
    assert len(head["states"]) == len({(s["view"], s["noise"]) for s in head["states"]}) == 9
    assert head["states"][head["start"][0]]["view"] == "posterior"
    assert [s["images"] for s in head["states"]] == [1] * 6 + [20] * 3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::fmsync.diagnostics.ConvergenceWarning")  # a short chain will do here
def test_the_picture_tells_the_truth():
    story = overview.compute(n_vertices=1000, n_draws=60, warmup=60)
    loops = {name: np.linalg.norm(x @ y @ z - np.eye(20)) for name, (x, y, z) in story.matrices.items()}
    assert loops["synchronised"] < 1e-9 < 1 < loops["observed"]
    assert story.spread.shape == (story.shapes[-1].n_vertices,)
    assert (story.spread > 0).all()
    home = story.colours["observed"][0]
    off = {name: np.abs(colours[-1] - home).mean() for name, colours in story.colours.items()}  # same vertex order
    assert off["synchronised"] < 0.7 * off["observed"]


def test_licences_name_each_package_once_and_what_is_not_installed():
    extras = {"a": ["tqdm"], "own": ["fmsync[viz]"]}
    rows = book.licence_table({"dependencies": ["tqdm>=4", "no_such>=1"], "optional-dependencies": extras})
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| no_such", "| tqdm"]
    assert rows[2].endswith("| – | – |")
    assert rows[3].startswith("| tqdm | core | ")
    assert "MIT" in rows[3]
