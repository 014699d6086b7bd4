"""Whatever a scan is called, what is said of it is one line and what is written can be read."""

import json

from hypothesis import given
from hypothesis import strategies as st

from sapwood.text import encodable, to_json, visible

names = st.text(st.characters(codec=None), max_size=20)  # any code point, lone surrogates among them


@given(names)
def test_visible_text_is_one_line_that_steers_no_terminal(name):
    said = visible(name)
    assert said.isprintable()
    assert visible(said) == said
    assert said == name or not name.isprintable()


@given(names, st.sampled_from([None, "utf-8", "ascii", "latin-1"]))
def test_encodable_text_can_be_written(name, encoding):
    encodable(name, encoding).encode(encoding or "utf-8")


def test_what_can_be_written_stays():
    assert encodable("Föhre 樹", None) == "Föhre 樹"
    assert encodable("Föhre 樹", "latin-1") == r"Föhre \u6a39"
    assert visible("tab\tand \x1b[31mred\n\udcff") == r"tab\tand \x1b[31mred\n\udcff"


@given(names, st.sampled_from([None, "utf-8", "ascii", "latin-1"]))
def test_json_can_be_written_and_reads_back(name, encoding):
    text = to_json({"name": name}, encoding)
    assert json.loads(text.encode(encoding or "utf-8").decode(encoding or "utf-8")) == {"name": name}
    assert text.endswith("}\n")


def test_json_is_escaped_only_where_it_must_be():
    assert "樹" in to_json({"name": "樹"})
    assert "\\u6a39" in to_json({"name": "樹"}, "latin-1")
