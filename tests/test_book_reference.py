"""The reference pages keep to the code: names exist, sources are cited."""

import importlib
import inspect
import re
from pathlib import Path

import fmsync
import fmsync.samplers
from fmsync.samplers.rlfm import RLFM

BOOK = Path(__file__).resolve().parents[1] / "book"


def test_every_source_is_cited_and_every_citation_has_a_source():
    keys = set(re.findall(r"^@\w+\{(\S+),$", (BOOK / "references.bib").read_text(encoding="utf-8"), re.M))
    cited = set()
    for page in BOOK.rglob("*.md"):
        for group in re.findall(r"\{cite[\w:]*\}`([^`]+)`", page.read_text(encoding="utf-8")):
            cited |= {key.strip() for key in group.split(",")}
    assert keys
    assert cited == keys


def _exists(dotted: str) -> bool:
    """Whether a dotted name leads to a module, a member, a field, or an attribute that a class gives its objects."""
    parts = dotted.split(".")
    thing = importlib.import_module(parts[0])
    for k, part in enumerate(parts[1:], 1):
        if isinstance(thing, type) and part in getattr(thing, "__dataclass_fields__", {}):
            return k == len(parts) - 1
        if isinstance(thing, type) and not hasattr(thing, part):
            return f"self.{part} =" in inspect.getsource(thing)
        if not hasattr(thing, part):
            try:
                importlib.import_module(".".join(parts[: k + 1]))
            except ModuleNotFoundError:
                return False
        thing = getattr(thing, part)
    return True


def test_lookup_finds_what_is_there_and_nothing_else():
    there = ("fmsync.SyncProblem.maps", "fmsync.so.exp", "fmsync.Estimate.relative", "pyFM.FMN.FMN.CLB")
    assert all(map(_exists, there))
    assert not any(
        map(_exists, ("fmsync.SyncProblem.map", "fmsync.so.exponential", "fmsync.nothing", "pyFM.FMN.FMN.CLBB"))
    )


def _tables() -> list[list[str]]:
    """Cells of the rows of the notation tables: paper, meaning, ours, pyFM's."""
    text = (BOOK / "reference" / "notation.md").read_text(encoding="utf-8")
    rows = [line.strip().strip("|").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    return [row for row in rows if row[0].strip() not in ("paper", "symbol", "---")]


def _of(cell: str) -> tuple[list[str], bool, str]:
    """``x`, `y` of `name`` as options (are they strings?) and name; without "of", no options."""
    options, _, name = cell.rpartition(" of ")
    found = re.search(r"`(?:[^`<]+<)?([A-Za-z][\w.]*)>?`", name)
    return re.findall(r"[\w-]+", options), '"' in options, found[1] if found else ""


def test_every_name_of_the_notation_table_exists():
    names = [name for row in _tables() if (name := _of(row[2])[2])]
    assert len(names) == len(_tables())
    full = [name if name.startswith(("fmsync.", "data_gen.")) else f"fmsync.{name}" for name in names]
    assert [name for name in full if not _exists(name)] == []


def test_every_pyfm_name_of_the_notation_table_exists():
    names = [name for row in _tables() if len(row) > 3 and (name := _of(row[3])[2])]
    assert len(names) > 15
    rooms = ("mesh", "FMN", "spectral", "signatures", "optimize")
    assert [name for name in names if not any(_exists(f"pyFM.{room}.{name}") for room in rooms)] == []


def test_every_option_and_method_of_the_notation_table_exists():
    known = {"fmsync.solve": set(fmsync.methods()), "fmsync.sample": set(fmsync.samplers.methods())}
    checked = 0
    for options, are_methods, function in (_of(row[2]) for row in _tables()):
        if not options:
            continue
        room, _, name = function.rpartition(".")
        parameters = set(inspect.signature(getattr(importlib.import_module(room), name)).parameters)
        if function == "fmsync.sample":
            parameters |= set(inspect.signature(RLFM).parameters)
        assert set(options) <= (known[function] if are_methods else parameters), function
        checked += 1
    assert checked > 8
