"""What an installation holds: the core with few packages, the rest in extras that are named where they are missing."""

import ast
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from bench.__main__ import NEEDED

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
FOLDERS = {"fmsync/matching": "shapes", "fmsync/viz": "viz", "bench": "bench"}  # their files may import more
OURS = {"fmsync", "data_gen", "bench"}
NO_INDEX = ("error sending request", "Failed to fetch", "network was disabled")  # words of uv

CORE = """
import numpy as np
import data_gen, fmsync
from fmsync import *

problem = data_gen.perturb(data_gen.planted(5, 3, rng=0), sigma2=0.05, rng=1)
post = fmsync.sample(problem, "heat-bath", kappa=20.0, n_draws=500, rng=0)
table = post.summary()
assert table["energy"]["r_hat"] < 1.1 and table["energy"]["ess_bulk"] > 100
for name in fmsync.methods():
    fmsync.solve(problem, name, rng=0)
octahedron = np.vstack([np.eye(3), -np.eye(3)])
faces = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
with open("octahedron.off", "w") as file:
    print("OFF 6 8 0", *octahedron.ravel(), *(f"3 {a} {b} {c}" for a, b, c in faces), file=file)
shape = data_gen.load_collection(["octahedron.off"])[0]
assert fmsync.laplace_beltrami(shape.vertices, shape.faces, 4).n == 4
"""
ARVIZ = """
import arviz as az
import fmsync, numpy as np
from fmsync import so

rng, edges = np.random.default_rng(0), [[0, 1], [1, 2], [0, 2]]
problem = fmsync.SyncProblem(3, edges, so.random_uniform(4, 3, rng))
maps = so.random_uniform(4, (2, 60, 3), rng)
energy, kappa = rng.random((2, 2, 60))
post = fmsync.Posterior(problem, "mine", maps, energy, kappa, False, {"kappa_inferred": True})
data = post.to_arviz()
assert type(data) is az.InferenceData
assert data.posterior["trace"].shape == (2, 60, 3)
assert abs(float(az.rhat(data)["log_kappa"]) / fmsync.diagnostics.rhat(np.log(post.kappa)) - 1) < 1e-10
back = fmsync.Posterior.from_arviz(data, problem)
assert (back.absolute == maps).all() and (back.kappa == post.kappa).all()
assert (back.method, back.settings) == (post.method, post.settings)
"""
MISSING = """
import data_gen, fmsync
import numpy as np

for use in (
    lambda: fmsync.viz,
    lambda: fmsync.matching,
    lambda: fmsync.synchronize_shapes,
    lambda: fmsync.laplace_beltrami(np.random.default_rng(0).random((40, 3)), None, 3),
    lambda: data_gen.load_collection("cats", count=1, n_vertices=1000),
):
    try:
        use()
    except ImportError as error:
        print(error)
"""


def uv(*arguments: str | Path) -> None:
    """Run uv; without an index the test is skipped, but not on a build server."""
    command = shutil.which("uv", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if command is None:
        pytest.fail("uv is not installed: pip install uv")
    done = subprocess.run([command, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode and not os.environ.get("CI") and any(words in done.stderr for words in NO_INDEX):
        pytest.skip(f"the package index cannot be reached: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Runs commands of an empty environment into which the wheel was installed, in a folder of its own."""
    folder = tmp_path_factory.mktemp("plain")
    source, environment, work = folder / "source", folder / "environment", folder / "work"
    for name in ("fmsync", "data_gen", "bench"):  # a copy: building leaves folders behind
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    uv("build", "--wheel", "--python", sys.executable, source, "-o", folder)
    uv("venv", "--python", sys.executable, environment)
    python = environment / "bin" / "python"
    uv("pip", "install", "--python", python, "-c", ROOT / "requirements.txt", *folder.glob("*.whl"))
    installed = next(environment.glob("lib/python*/site-packages"))
    for file in (ROOT / "fmsync").rglob("*.nb[ic]"):  # what Numba has compiled of sources of this time and size
        kept = installed / file.relative_to(ROOT)
        kept.parent.mkdir(exist_ok=True)
        shutil.copy(file, kept)
    for file in (ROOT / "fmsync").rglob("*.py"):
        shutil.copystat(file, installed / file.relative_to(ROOT))
    work.mkdir()
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "FMSYNC_DATA")}
    variables["XDG_CACHE_HOME"] = str(folder / "cache")

    def run(command: str, *arguments: str) -> subprocess.CompletedProcess:
        return subprocess.run(
            [environment / "bin" / command, *arguments], cwd=work, env=variables, capture_output=True, text=True
        )

    run.folder = work
    return run


def test_a_plain_installation_runs_the_first_example_of_the_readme(plain):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    example = re.search(r"```python\n(.*?)```", readme, re.DOTALL)[1]
    assert "fmsync.certify" in example
    (plain.folder / "example.txt").write_text(example, encoding="utf-8")
    done = plain("python", "-m", "doctest", "example.txt")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    helped = plain("fmsync", "--help")
    assert helped.returncode == 0
    assert "sync" in helped.stdout


def test_a_plain_installation_solves_and_samples_and_reads_meshes(plain):
    done = plain("python", "-c", CORE)  # where the checkout has not been used, half a minute of compiling
    assert done.returncode == 0, done.stderr


def test_a_plain_installation_is_small_and_names_the_extra_that_is_missing(plain):
    absent = ("pandas", "pyvista", "matplotlib", "pymanopt", "joblib", "bench")
    look = f"from importlib.util import find_spec; print([n for n in {absent} if find_spec(n)])"
    assert plain("python", "-c", look).stdout == "[]\n"
    refused = plain("fmsync", "sync", "x", "-o", "y")
    needs = {extra: f'needs the extra "{extra}": pip install "fmsync[{extra}]"' for extra in EXTRAS}
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == f"fmsync: fmsync.matching {needs['shapes']}\n"
    listed = plain("python", "-m", "data_gen", "report", "cats")
    assert (listed.returncode, listed.stderr) == (1, f"importing pyvista {needs['shapes']}\n")
    said = plain("python", "-c", MISSING).stdout.splitlines()
    assert said == [
        f"fmsync.viz {needs['viz']}",
        f"fmsync.matching {needs['shapes']}",
        f"fmsync.matching {needs['shapes']}",
        f"importing robust_laplacian {needs['shapes']}",
        f"importing pyvista {needs['shapes']}",
    ]


def test_arviz_before_1_is_given_inference_data_and_gives_it_back(plain, tmp_path):
    python = plain.folder.parent / "environment" / "bin" / "python"
    uv("pip", "install", "--python", python, "--target", tmp_path, "-c", ROOT / "requirements.txt", "arviz<1")
    done = plain("python", "-W", "ignore", "-c", f"import sys; sys.path.append({str(tmp_path)!r})\n{ARVIZ}")
    assert (done.returncode, done.stderr) == (0, "")


def requirements(extra: str | None = None) -> list[Requirement]:
    """What the core, or an extra of ours and the extras that it includes, asks for."""
    found = []
    for requirement in map(Requirement, PROJECT["dependencies"] if extra is None else EXTRAS[extra]):
        if requirement.name == PROJECT["name"]:
            for included in requirement.extras:
                found += requirements(included)
        else:
            found.append(requirement)
    return found


@cache
def packages(extra: str | None = None) -> frozenset[str]:
    """Canonical names of these, and of what their own extras add: ``distributed`` for ``dask[distributed]``."""
    names = set()
    for requirement in requirements(extra):
        names.add(canonicalize_name(requirement.name))
        for theirs in requirement.extras:
            for line in importlib.metadata.requires(requirement.name):
                added = Requirement(line)
                if added.marker and added.marker.evaluate({"extra": theirs}) and not added.marker.evaluate():
                    names.add(canonicalize_name(added.name))
    return frozenset(names)


def package(module: str) -> str:
    """Canonical name of the package that installs a module."""
    top = module.partition(".")[0]
    assert top in installed(), f"{top}: no package installs it"
    return canonicalize_name(installed()[top][0])


@cache
def installed() -> dict[str, list[str]]:
    """Packages that hold each top-level module of this environment; reading all of their records takes seconds."""
    return dict(importlib.metadata.packages_distributions())


def imports(file: Path) -> Iterator[tuple[str, str | None, bool]]:
    """Modules of others that a file imports, the extra it names for it (or None), and whether inside a function."""

    def visit(node: ast.AST, inside: bool) -> Iterator[tuple[str, str | None, bool]]:
        if isinstance(node, ast.Import):
            yield from ((alias.name, None, inside) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module, None, inside
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "require":
            module, extra = (ast.literal_eval(argument) for argument in node.args)
            yield module, extra, inside
        inside = inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for child in ast.iter_child_nodes(node):
            yield from visit(child, inside)

    for module, extra, inside in visit(ast.parse(file.read_text(encoding="utf-8")), False):
        if module.partition(".")[0] not in {*sys.stdlib_module_names, *OURS}:
            yield module, extra, inside


def files(*folders: str) -> list[Path]:
    return [file for folder in folders for file in sorted((ROOT / folder).rglob("*.py"))]


def extra_of(file: Path) -> str | None:
    """The extra whose packages a file may import directly."""
    path = file.relative_to(ROOT).as_posix()
    return next((extra for folder, extra in FOLDERS.items() if path.startswith(f"{folder}/")), None)


def test_the_walk_sees_every_way_to_import(tmp_path):
    file = tmp_path / "file.py"
    file.write_text(
        "import os, numpy as np\nfrom scipy.linalg import eigh\nfrom fmsync import so\n"
        "def f():\n    import pandas\n    pv = require('pyvista', 'viz')\n"
    )
    assert list(imports(file)) == [
        ("numpy", None, False),
        ("scipy.linalg", None, False),
        ("pandas", None, True),
        ("pyvista", "viz", True),
    ]


@pytest.mark.parametrize("file", files("fmsync", "data_gen", "bench"), ids=lambda f: f.relative_to(ROOT).as_posix())
def test_every_import_is_declared_where_it_is_used(file):
    own = extra_of(file)
    for module, named, inside in imports(file):
        name = package(module)
        if named is not None:
            assert name in packages(named), f'{module}: add {name} to the extra "{named}" of pyproject.toml'
        elif name not in packages():
            assert own is not None, f"{module}: not of the core; import it through fmsync.extras.require"
            assert name in packages(own), f'{module}: add {name} to the extra "{own}" of pyproject.toml'
            assert own == "bench" or not inside, f"{module}: import it through fmsync.extras.require in a function"


def test_the_core_has_few_packages_and_uses_each():
    core = packages()
    assert len(core) <= 8
    in_core = [file for file in files("fmsync", "data_gen") if extra_of(file) is None]
    used = {package(module) for file in in_core for module, named, _ in imports(file) if named is None}
    assert used == core


@pytest.mark.parametrize(("folder", "extra"), [("fmsync/matching", "shapes"), ("fmsync/viz", "viz")])
def test_a_package_that_needs_an_extra_asks_for_all_of_it_at_once(folder, extra):
    used = {module for file in files(folder) for module, _, _ in imports(file)}
    optional = {module.partition(".")[0] for module in used if package(module) not in packages()}
    call = next(
        node
        for node in ast.walk(ast.parse((ROOT / folder / "__init__.py").read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and node.func.id == "require_all"
    )
    named, *asked = (ast.literal_eval(argument) for argument in call.args[1:])
    assert named == extra
    assert set(asked) == optional
    assert {package(module) for module in asked} == packages(extra)


def test_the_benchmark_asks_for_all_that_it_imports():
    used = {module for file in files("bench") for module, _, _ in imports(file)}
    assert set(NEEDED) == {module.partition(".")[0] for module in used if package(module) not in packages()} | {
        "pyarrow",  # pandas imports it to read and write tables
        "geomstats",  # fmsync.adapters imports it for the peers
    }
    assert {package(module) for module in NEEDED} <= packages("bench")


def test_the_lock_holds_every_package_of_every_extra():
    lock = {}
    for line in (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines():
        if line[:1].isalnum():  # what follows are hashes and who asked for the package
            pinned = Requirement(line.removesuffix("\\"))
            if pinned.marker is None or pinned.marker.evaluate():
                lock[canonicalize_name(pinned.name)] = str(pinned.specifier).removeprefix("==")
    for extra in (None, *EXTRAS):
        for requirement in requirements(extra):
            name = canonicalize_name(requirement.name)
            assert name in lock, f"{name} of {extra}: write requirements.txt again, as requirements.in says"
            assert requirement.specifier.contains(lock[name]), f"{requirement} of {extra}: {lock[name]} in the lock"
    assert (ROOT / "requirements.in").read_text(encoding="utf-8").splitlines()[-1] == ".[book,test]"
