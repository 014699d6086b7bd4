"""The README says what happens: its examples are run, and their output compared with what it prints."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "tools"))
import examples  # noqa: E402

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = examples.BLOCK.findall(TEXT)


def first(kind):
    return next(body for found, body in BLOCKS if found == kind)


@pytest.mark.parametrize("kind, body", BLOCKS, ids=[kind for kind, _ in BLOCKS])
def test_example_prints_what_the_readme_says(kind, body):
    found = examples.examples(kind, body)
    with examples.workplace():
        printed = examples.run(kind, found)
    for example, output in zip(found, printed, strict=True):
        assert examples.same(example.expected, output), (
            f"README.md is out of date (make docs writes it anew):\n{example.source}\n"
            f"says:   {example.expected}\nprints: {output}"
        )


def test_first_screen():
    """Name, one sentence, a picture, two commands with their output, five lines of Python with theirs."""
    screen = "\n".join(TEXT.splitlines()[:45])
    assert TEXT.startswith("# Sapwood\n")
    assert "](docs/pictures/" in screen
    console = examples.examples("console", first("console"))
    assert len(console) == 2
    assert all(example.expected for example in console)
    python = examples.examples("python", first("python"))
    assert len(python) == 5
    assert any("<Reconstruction " in example.expected for example in python)
    assert first("console") in screen
    assert first("python") in screen


#: Pictures of grown trees, or of several samples, by the page that shows them.
GROWN = {
    "ages.png": "growth",
    "curve.png": "fitting",
    "figure6.png": "growth",
    "mapping.png": "similarity",
    "plastic.png": "plastic",
    "reliability.png": "classify",
    "wall.png": "growth",
}


def test_pictures_are_of_shipped_scans_or_of_grown_trees():
    pictures = sorted((ROOT / "docs" / "pictures").glob("*.png"))
    assert len(pictures) >= 3
    assert {picture.name for picture in pictures} >= GROWN.keys()
    for picture in pictures:
        if picture.name in GROWN:
            page = ROOT / "docs" / f"{GROWN[picture.name]}.md"
            assert f"](pictures/{picture.name})" in page.read_text(encoding="utf-8")
            continue
        assert (ROOT / "samples" / f"{picture.stem}.laz").exists()
        assert f"docs/pictures/{picture.name}" in TEXT


def test_every_command_is_listed():
    from sapwood.cli.main import COMMANDS

    for name in {command.split()[0] for command in COMMANDS}:
        assert f"| `sapwood {name}" in TEXT or f"| `{name} " in TEXT


@pytest.mark.parametrize(
    "expected, got, alike",
    [
        ("18.4 m high, 67 nodes", "18.5 m high, 66 nodes", True),
        ("18.4 m high, 67 nodes", "18.4 m high, 77 nodes", False),
        ("18.4 m high", "18.4 m wide", False),
        ("((67, 3), (80, 3))", "((67, 3), (80, 4))", False),
        ("oak.lobes (17.6 kB)", "ash.lobes (17.6 kB)", False),
        ("", "surprise", False),
        ("", "", True),
    ],
)
def test_what_counts_as_the_same(expected, got, alike):
    assert examples.same(expected, got) == alike


def test_rewriting_puts_the_output_in():
    body = "$ one\nold\n$ two\n"
    assert examples.rewrite("console", body, ["new\n", "2\n"]) == "$ one\nnew\n$ two\n2\n"
    body = ">>> a = [\n...     1]\n>>> a\nold\n"
    assert examples.rewrite("python", body, ["", "[1]\n"]) == ">>> a = [\n...     1]\n>>> a\n[1]\n"


def test_failing_command_is_told():
    with pytest.raises(RuntimeError, match="'exit 3' ended with 3"):
        examples.run_console(["exit 3"])
