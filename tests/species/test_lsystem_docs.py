"""The reference of the language: its examples run, and it names everything there is."""

import doctest
import re
from pathlib import Path

import numpy as np
import pytest

from species import derive_word, draw_word, parse_grammar
from species.lsystem.syntax import COMMANDS, FUNCTIONS, KEYWORDS

PAGE = (Path(__file__).parents[2] / "docs" / "lsystem.md").read_text(encoding="utf-8")
GRAMMARS = re.findall(r"^```grammar\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def test_examples_print_what_the_page_says():
    sessions = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    assert len(sessions) == 3
    test = doctest.DocTestParser().get_doctest("\n".join(sessions), {"text": GRAMMARS[0]}, "lsystem", None, 0)
    said = []
    failed, tried = doctest.DocTestRunner().run(test, out=said.append)
    assert tried >= 8
    assert failed == 0, "".join(said)


@pytest.mark.parametrize("text", GRAMMARS, ids=range(len(GRAMMARS)))
def test_grammars_of_the_page_grow(text):
    grammar = parse_grammar(text)
    assert parse_grammar(str(grammar)) == grammar
    n = None if "iterations" in grammar.settings else 2
    drawing = draw_word(derive_word(grammar, rng=np.random.default_rng(0), iterations=n))
    if "Fa" not in text:
        assert drawing.tree.n_nodes > 10


def test_the_compound_leaf_is_one():
    """Pairs at one height, a single leaflet of kind 1 at the end; the stalk droops."""
    grammar = next(parse_grammar(text) for text in GRAMMARS if "pairs" in text)
    drawing = draw_word(derive_word(grammar, rng=np.random.default_rng(0), parameters={"pairs": 4}))
    leaves = drawing.leaves
    assert leaves.kind.tolist() == [0] * 8 + [1]
    assert (leaves.node[0:8:2] == leaves.node[1:8:2]).all()
    step = np.diff(drawing.tree.position, axis=0)
    slope = step[:, 2] / np.linalg.norm(step, axis=1)
    assert (np.diff(slope) < 0).all()
    np.testing.assert_allclose(leaves.along[0:8:2, 2], leaves.along[1:8:2, 2], atol=1e-12)


def test_everything_is_named():
    for name in (*KEYWORDS, *FUNCTIONS):
        assert re.search(rf"`{name}\b", PAGE), name
    table = PAGE[PAGE.index("| command | meaning |") : PAGE.index("Any other module")]
    for command in COMMANDS:
        written = "\\|" if command == "|" else command
        assert f"`{written}" in table, command
