"""Pack the rendered book into one file that opens from disk; the same pages give the same bytes."""

import os
import time
import zipfile
from pathlib import Path

BUILD = Path(__file__).resolve().parents[1] / "_build"
_EARLIEST = 315532800  # 1980, where the dates of zip files begin


def pack(html: Path, archive: Path) -> int:
    """Write every file below ``html`` into ``archive``; gives their number.

    Sorted names, one date (``SOURCE_DATE_EPOCH``, or 1980) and one mode tell nothing of when and where it was made.
    """
    date = time.gmtime(max(int(os.environ.get("SOURCE_DATE_EPOCH") or 0), _EARLIEST))[:6]
    files = sorted(p for p in html.rglob("*") if p.is_file() and not p.name.startswith("."))
    if not (html / "index.html").is_file():
        raise ValueError(f"{html} holds no index.html: build the book first (make book)")
    unfinished = archive.with_suffix(".part")
    with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as packed:
        for file in files:
            info = zipfile.ZipInfo(f"fmsync-book/{file.relative_to(html).as_posix()}", date)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o644 << 16
            packed.writestr(info, file.read_bytes())
    unfinished.replace(archive)
    return len(files)


if __name__ == "__main__":
    print(f"{BUILD / 'book.zip'}: {pack(BUILD / 'html', BUILD / 'book.zip')} files; open index.html in it")
