"""Claims are recorded with their margins, and a claim that fails in one world is named."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import data_gen

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "scripts"))
import claims  # noqa: E402
import worlds  # noqa: E402

PAGE = """---
kernelspec:
  name: python3
  display_name: Python 3
---

```{code-cell} ipython3
import warnings
import data_gen
from fmsync.diagnostics import ConvergenceWarning
warnings.warn("R-hat is large", ConvergenceWarning)
```

```{code-cell} ipython3
assert data_gen.seed(0) == 5 and 1 < 3
assert 2.0 < 1.5
```
"""


def recorded(code: str, **names) -> list[dict]:
    found = []
    tree = claims.Claims().visit(ast.parse(code))
    exec(compile(tree, "page", "exec"), names | {"__claim__": lambda *a: found.append(claims.check(*a)), "np": np})
    return found


def test_margins_of_comparisons_chains_arrays_and_plain_truths():
    (one,) = recorded("assert a < b", a=1, b=3)
    assert one == {"claim": "a < b", "holds": True, "values": [1.0, 3.0], "margin": 2.0}
    first, second = recorded("assert a < b and not a", a=1, b=0.5)
    assert (first["holds"], first["margin"]) == (False, -0.5)
    assert (second["holds"], second["margin"]) == (False, None)
    (chain,) = recorded("assert 0 < a < 1", a=0.8)
    assert chain["margin"] == pytest.approx(0.2)
    (array,) = recorded("assert (x > 1).all()", x=np.array([3.0, 1.5]))
    assert (array["holds"], array["margin"]) == (True, 0.5)
    (text,) = recorded("assert 'cat' in name", name="cat0")
    assert (text["holds"], text["margin"]) == (True, None)


def test_a_claim_that_fails_is_named_and_finished_runs_are_not_repeated(tmp_path, monkeypatch, capsys):
    page = tmp_path / "page.md"
    page.write_text(PAGE, encoding="utf-8")
    monkeypatch.setattr(worlds, "pages", lambda: [page])
    monkeypatch.setattr(worlds, "shifts", lambda seed: [5])
    monkeypatch.setattr(worlds, "ROOT", tmp_path)
    monkeypatch.setattr(worlds, "TABLE", tmp_path / "worlds.json")
    monkeypatch.setattr(sys, "argv", ["worlds.py", "page"])
    monkeypatch.delenv("FMSYNC_SEED_SHIFT", raising=False)
    assert worlds.main() == 1
    told = capsys.readouterr().out
    assert "page native +5: 2.0 < 1.5: 2 and 1.5, margin -0.5" in told
    assert "page other +5: warning: R-hat is large" in told
    assert "seed(0) == 5" not in told  # held: the shift reached the page
    table = json.loads((tmp_path / "worlds.json").read_text(encoding="utf-8"))
    assert table["worlds"] == ["native +5", "other +5"]
    assert len(table["chapters"]["page"]["failures"][0]) == 2
    kept = sorted((tmp_path / "_build" / "worlds").rglob("*.json"))
    assert len(kept) == 2
    before = [file.stat().st_mtime_ns for file in kept]
    assert worlds.main() == 1
    assert [file.stat().st_mtime_ns for file in kept] == before


def test_bad_input_is_refused_by_name(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["worlds.py", "no_such_chapter"])
    assert worlds.main() == 2
    assert "no_such_chapter" in capsys.readouterr().err
    monkeypatch.setattr(sys, "argv", ["worlds.py"])
    monkeypatch.setenv("FMSYNC_SEED_SHIFT", "3")
    assert worlds.main() == 2
    assert "FMSYNC_SEED_SHIFT" in capsys.readouterr().err


@pytest.mark.parametrize("shift", ["0", "17", "-1", "123456789012345678901234567890"])
def test_any_integer_shifts_the_seeds(monkeypatch, shift):
    monkeypatch.setenv("FMSYNC_SEED_SHIFT", shift)
    seeds = [data_gen.seed(k) for k in range(3)]
    assert seeds[0] == int(shift) % 2**32
    assert len(set(seeds)) == 3
    np.random.default_rng(seeds[0])


@pytest.mark.parametrize("shift", ["", "half", "1.5"])
def test_a_shift_that_is_no_integer_is_refused_by_name(monkeypatch, shift):
    monkeypatch.setenv("FMSYNC_SEED_SHIFT", shift)
    with pytest.raises(ValueError, match="FMSYNC_SEED_SHIFT"):
        data_gen.seed(0)


def test_the_other_arithmetic_differs_in_the_last_bits():
    code = "import numpy as np; a = np.random.default_rng(0).standard_normal((50, 50)); print((a @ a).tobytes().hex())"
    other = [sys.executable, str(ROOT / "scripts" / "other_arithmetic.py"), sys.executable, "-c", code]
    native = {name: value for name, value in os.environ.items() if name != "OPENBLAS_CORETYPE"}
    here, there = (
        np.frombuffer(bytes.fromhex(subprocess.check_output(command, env=native, text=True).strip()))
        for command in (other[2:], other)
    )
    assert np.allclose(here, there, rtol=1e-10)
    assert not np.array_equal(here, there)
