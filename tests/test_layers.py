"""Imports point downwards only: a package may use the floors below its own, never its own floor or above."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

#: Floor of every top-level package (docs/design.md, "The house"); written or not yet.
FLOOR = {
    "treegraph": 1,
    "recon": 2,
    "classify": 2,
    "species": 2,
    "inverse": 3,
    "plastic": 3,
    "morphogenesis": 3,
    "shapespace": 3,
    "render": 3,
    "forest": 4,
    "sapwood": 5,
}
PACKAGES = sorted(name for name in FLOOR if (ROOT / name / "__init__.py").exists())

#: Modules that cost 0.2 s and more to import: inside functions only, so that commands start at once.
HEAVY = {"numba", "open3d", "matplotlib", "pyrender", "pymeshlab", "trimesh", "sklearn", "dask", "pye57"}

#: Modules that hold a subclass of a heavy module's class, which cannot be made without it; loaded lazily.
SUBCLASSES = {"classify/jointboost.py": {"sklearn"}}


def imported_names(tree, *, top_level_only=False):
    """Yield (line, top-level name) of every absolute import."""
    nodes = ast.walk(tree) if not top_level_only else module_level(tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name.split(".")[0]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.lineno, node.module.split(".")[0]


def module_level(tree):
    """Statements that run at import: everything outside functions and outside ``if TYPE_CHECKING``."""
    pending = list(tree.body)
    while pending:
        node = pending.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            pending.extend(node.orelse)
            continue
        yield node
        pending.extend(child for child in ast.iter_child_nodes(node) if isinstance(child, ast.stmt))


def violations(package, source, path="example.py"):
    """Return one line for each import in `source` that does not point down from `package`."""
    found = []
    for line, name in imported_names(ast.parse(source)):
        if name in FLOOR and name != package and FLOOR[name] >= FLOOR[package]:
            below = f"{package} (floor {FLOOR[package]}) must not import {name} (floor {FLOOR[name]})"
            found.append(f"{path}:{line}: {below}")
    return found


def sources(package):
    return sorted((ROOT / package).rglob("*.py"))


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_point_down(package):
    found = []
    for path in sources(package):
        found += violations(package, path.read_text(encoding="utf-8"), path.relative_to(ROOT))
    assert not found, "\n".join(found)


@pytest.mark.parametrize("package", PACKAGES)
def test_heavy_modules_are_imported_inside_functions(package):
    found = []
    for path in sources(package):
        if path.name.endswith("_kernels.py"):  # kernel modules hold nothing else and are imported lazily
            continue
        for line, name in imported_names(ast.parse(path.read_text(encoding="utf-8")), top_level_only=True):
            if name in HEAVY - SUBCLASSES.get(path.relative_to(ROOT).as_posix(), set()):
                found.append(
                    f"{path.relative_to(ROOT)}:{line}: import {name} inside the function that needs it"
                )
    assert not found, "\n".join(found)


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_is_cheap(package):
    """Nothing heavy comes along by itself: neither directly nor through something else."""
    program = f"import sys, {package}; print(*sorted({HEAVY | {'scipy'}!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there(package):
    """Lazy names are strings; this finds the ones that lead nowhere."""
    module = importlib.import_module(package)
    missing = [name for name in module.__all__ if not hasattr(module, name)]
    assert not missing
    assert set(module.__all__) <= set(dir(module))


def test_every_package_is_on_a_floor():
    """A new top-level package has to be given its floor here before it can be used."""
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"tests"}
    assert packages <= set(FLOOR)
    assert packages == set(PACKAGES)


@pytest.mark.parametrize(
    "package, source, bad",
    [
        ("recon", "import treegraph", False),
        ("recon", "from treegraph.graph import TreeGraph", False),
        ("recon", "from recon.cloud import Cloud", False),
        ("recon", "import render", True),
        ("recon", "def f():\n    from sapwood import pipeline", True),
        ("treegraph", "from recon import encode", True),
        ("render", "import recon", False),
        ("render", "from inverse import fit", True),
        ("sapwood", "import render.mesh, recon", False),
    ],
)
def test_the_rule_itself(package, source, bad):
    assert bool(violations(package, source)) == bad
