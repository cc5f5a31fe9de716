"""The reference pages keep to the code: names exist, sources are cited."""

import importlib
import re
from pathlib import Path

BOOK = Path(__file__).resolve().parents[1] / "book"


def test_every_source_is_cited_and_every_citation_has_a_source():
    keys = set(re.findall(r"^@\w+\{(\S+),$", (BOOK / "references.bib").read_text(encoding="utf-8"), re.M))
    cited = set()
    for page in BOOK.rglob("*.md"):
        for group in re.findall(r"\{cite[\w:]*\}`([^`]+)`", page.read_text(encoding="utf-8")):
            cited |= {key.strip() for key in group.split(",")}
    assert keys and cited == keys
