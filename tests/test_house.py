"""The house keeps its own rules: one version, documented chores, clean files, shipped licences."""

import ast
import importlib.metadata
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = sorted(
    path.parent.name
    for path in ROOT.glob("*/__init__.py")
    if path.parent.name not in {"tests", "benchmarks", "tools"}
)

#: What must not stand in a file of the repository: paths of somebody's machine, hosts of package registries.
FORBIDDEN = re.compile(
    r"(?<![\w.])/(?:home|Users|root|work|opt)/\w"
    r"|[A-Z]:\\Users\\"
    r"|files\.pythonhosted\.org|pypi\.org/simple|(?:index|extra-index|registry)[-_]url",
    re.IGNORECASE,
)
BINARY = {
    ".twigs",
    ".laz",
    ".las",
    ".png",
    ".gif",
    ".jpg",
    ".glb",
    ".lobes",
    ".npz",
    ".npy",
    ".e57",
    ".pcd",
    ".ply",
}
LARGEST_FILE = 2_000_000  # bytes; what is larger belongs elsewhere


def tracked_files():
    """Every file of the repository: what git tracks, or, in an unpacked archive, what lies there."""
    try:
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached"], cwd=ROOT, capture_output=True, check=True, text=True
        ).stdout
    except (OSError, subprocess.CalledProcessError):
        skipped = re.compile(r"(^|/)(\.[^/]+|__pycache__|demo-output|build|dist|[^/]*\.egg-info)/")
        found = [path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*") if path.is_file()]
        return [ROOT / name for name in found if not skipped.search(name)]
    return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).exists()]


def makefile_targets():
    text = (ROOT / "Makefile").read_text(encoding="utf-8")
    return text, set(re.findall(r"^([a-z][\w-]*):(?!=)", text, re.MULTILINE))


# ---------------------------------------------------------------- version


def test_version_is_said_once():
    assert "version" in PROJECT["project"]["dynamic"]
    assert "version" not in PROJECT["project"]
    assert PROJECT["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "sapwood._version.__version__"}
    assigned = [
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and "__version__" in [getattr(t, "id", None) for t in node.targets]
    ]
    assert assigned == ["sapwood/_version.py"]


def test_version_is_a_release_number_and_in_the_changelog():
    import sapwood

    assert re.fullmatch(r"\d+\.\d+\.\d+(\.dev\d+|a\d+|b\d+|rc\d+)?", sapwood.__version__)
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## {sapwood.__version__}" in changelog


def test_installed_version_is_the_source_version():
    import sapwood

    try:
        installed = importlib.metadata.version("sapwood")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("sapwood is run from the checkout, not installed")
    assert installed == sapwood.__version__


# ---------------------------------------------------------------- packages


@pytest.mark.parametrize("package", PACKAGES)
def test_package_is_shipped_with_its_types(package):
    assert (ROOT / package / "py.typed").exists()
    assert f"{package}*" in PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
    assert package in PROJECT["tool"]["mypy"]["packages"]
    assert package in PROJECT["tool"]["coverage"]["run"]["source"]


def test_every_folder_of_a_package_is_a_package():
    """A folder without __init__.py would be left out of the wheel without a word."""
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            assert (path.parent / "__init__.py").exists(), (
                f"{path.parent.relative_to(ROOT)} lacks __init__.py"
            )


def test_shipped_names_are_no_more_than_there_are():
    shipped = {name.rstrip("*") for name in PROJECT["tool"]["setuptools"]["packages"]["find"]["include"]}
    assert shipped == set(PACKAGES)


def test_every_dependency_is_pinned():
    """constraints.txt has an exact version of everything that pyproject.toml names, for Linux on x86-64."""
    pins = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            match = re.fullmatch(r"([\w.-]+)==([\w.+]+)", line)
            assert match, f"constraints.txt: {line!r} is no exact pin"
            pins[re.sub(r"[-_.]+", "-", match[1]).lower()] = match[2]
    wanted = list(PROJECT["project"]["dependencies"])
    for extra in PROJECT["project"]["optional-dependencies"].values():
        wanted += extra
    for requirement in wanted:
        name = re.match(r"[\w.-]+", requirement)[0].lower()
        if name == "sapwood" or "!= 'linux'" in requirement:
            continue
        assert re.sub(r"[-_.]+", "-", name) in pins, f"{requirement} is not in constraints.txt"


# ---------------------------------------------------------------- chores


def test_every_target_is_in_help():
    text, targets = makefile_targets()
    documented = set(re.findall(r"^([a-z]+):.*## \S", text, re.MULTILINE))
    assert targets == documented
    assert targets >= {"help", "demo", "test", "check", "format", "bench", "docs"}


def test_every_target_is_phony():
    text, targets = makefile_targets()
    assert targets == set(re.search(r"^\.PHONY: (.*)$", text, re.MULTILINE)[1].split())


def test_help_lists_every_target():
    try:
        shown = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, check=True, text=True).stdout
    except OSError:
        pytest.skip("there is no make here")
    assert set(re.findall(r"^make (\w+) +\S", shown, re.MULTILINE)) == makefile_targets()[1]


@pytest.mark.parametrize("script", [".ci/run", "tools/setup.sh"])
def test_scripts_run(script):
    path = ROOT / script
    assert path.stat().st_mode & 0o111, f"{script} is not executable"
    subprocess.run(["bash", "-n", str(path)], check=True)


def test_setup_names_its_kinds():
    """An unknown kind is refused before anything is touched."""
    done = subprocess.run(
        [str(ROOT / "tools/setup.sh"), "nonsense"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "want 'run' or 'dev', got 'nonsense'" in done.stderr


# ---------------------------------------------------------------- files


def test_no_machine_paths_or_registry_hosts():
    found = []
    for path in tracked_files():
        if path.suffix.lower() in BINARY or path == Path(__file__):
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            if match := FORBIDDEN.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {match[0]}")
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "text, bad",
    [
        ("see /home/ann/scan.laz", True),
        ("cd /wo" + "rk/tree", True),
        ("--extra-index-url somewhere", True),
        ("https://files.pythonhosted.org/packages/x", True),
        ("https://example.org/home/page", False),
        ("wood/leaf, root/tip", False),
        ("../work", False),
    ],
)
def test_what_counts_as_a_machine_path(text, bad):
    assert bool(FORBIDDEN.search(text)) == bad


def test_no_file_is_large():
    large = [path.relative_to(ROOT) for path in tracked_files() if path.stat().st_size > LARGEST_FILE]
    assert not large


def test_local_links_lead_somewhere():
    """Every relative link and picture of every Markdown page points to a file that is there."""
    broken = []
    for path in tracked_files():
        if path.suffix != ".md":
            continue
        text = re.sub(r"```.*?```|`[^`\n]*`", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\(([^)\s]+)\)|<img[^>]+src=\"([^\"]+)\"", text):
            target = next(filter(None, target)).split("#")[0]
            if target and not re.match(r"[a-z]+:", target) and not (path.parent / target).exists():
                broken.append(f"{path.relative_to(ROOT)}: {target}")
    assert not broken, "\n".join(broken)


def test_every_page_is_in_the_index():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert [page.name for page in (ROOT / "docs").glob("*.md") if f"]({page.name})" not in index] == [
        "index.md"
    ]


# ---------------------------------------------------------------- samples


SAMPLES = sorted(path.name for path in (ROOT / "samples").iterdir() if path.suffix.lower() in BINARY)


@pytest.mark.parametrize("name", SAMPLES)
def test_sample_has_a_source_and_a_permissive_licence(name):
    rows = (ROOT / "samples" / "SOURCES.md").read_text(encoding="utf-8").splitlines()
    row = [line for line in rows if line.startswith(f"| `{name}`")]
    assert len(row) == 1, f"samples/SOURCES.md must have one row for {name}"
    licence = re.search(r"\]\((licences/[^)]+)\)", row[0])
    assert licence, f"the row of {name} names no licence file"
    text = (ROOT / "samples" / licence[1]).read_text(encoding="utf-8")
    assert "Permission is hereby granted, free of charge" in text or "Redistribution and use" in text


def test_there_are_samples():
    assert len(SAMPLES) >= 2


def test_licence_is_apache():
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "Apache License" in text
    assert "Version 2.0, January 2004" in text
    assert PROJECT["project"]["license"] == "Apache-2.0"


# ---------------------------------------------------------------- tests


def test_missing_system_library_skips_and_another_failure_does_not(pytester):
    pytester.makeconftest((ROOT / "tests" / "conftest.py").read_text(encoding="utf-8"))
    pytester.makepyfile(
        """
        def test_library():
            raise ImportError("libEGL.so.1: cannot open shared object file: No such file or directory")

        def test_module():
            raise ImportError("No module named 'nowhere'")

        def test_fine():
            pass
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider", "-rs")
    result.assert_outcomes(skipped=1, failed=1, passed=1)
    result.stdout.fnmatch_lines(["*the system library libEGL.so.1 is missing*"])
