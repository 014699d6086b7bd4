"""The 24 parameters: ranges, files, presets."""

import dataclasses
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from species import (
    GrowthParameters,
    Preset,
    find_preset,
    format_growth,
    parameter_table,
    presets,
    read_growth,
)
from treegraph import FormatError, InputError
from treegraph.errors import SapwoodError

TABLE = parameter_table()
# fmt: off
SYMBOLS = [
    "AAV", "NLB", "BAM", "BAV", "RAM", "RAV", "AB_D", "LB_D", "LF_A", "LF_L", "AD_BF", "AD_DF", "AD_AF",
    "GR", "IBL", "IL_AF", "AC", "AC_AF", "PT", "GT", "PF", "LB_PF", "GBS", "GBA",
]
# fmt: on

#: Table 2 of the paper, row by row, columns F6a, F6b, F6c, F6d, F6f (F6e is misprinted), the last one t.
TABLE_2 = """
AAV 38 0 10 5 12
NLB 4 2 2 1 2
BAM 38 41 51 45 43
BAV 2 3 4 5 3
RAM 91 87 100 130 80
RAV 1 2 30 3 4
AB_D 0 0 0 0 0
LB_D 0.21 0.21 0.015 0.01 0.21
LF_A 0.39 0.37 0.36 0.5 0.36
LF_L 1.13 1.05 0.65 0.03 1.05
AD_BF 3.13 0.37 6.29 5.59 0.38
AD_DF 0.13 0.31 0.9 0.5 0.31
AD_AF 0.82 0.9 0.87 0.979 0.9
GR 0.98 1.9 3.26 4.25 1.9
IBL 1.02 0.49 0.4 0.55 0.51
IL_AF 0.97 0.98 0.96 0.95 0.98
AC 2.4 0.27 6.2 5.5 0.25
AC_AF 0.85 0.90 0.9 0.91 0.70
PT 0.29 0.15 0.42 0.05 0.15
GT 0.61 0.17 0.43 -0.01 0.13
PF 0.05 0.82 0.12 0.48 0.80
LB_PF 1.3 2.83 1.25 5.5 2.90
GBS 0.73 0.195 0.94 0.09 0.19
GBA 0.05 0.14 0.52 0.89 0.14
t 8 26 14 28 30
"""
#: The printed column F6e from its second entry on, as the erratum reads it: BAM to PT, one row lower.
F6E_PRINTED = [60, 3, 130, 10, 0, 0.018, 0.03, 0.21, 0.5, 0.55, 0.91, 2.4, 0.4, 0.97, 5.5, 0.92, 0.05]


def base():
    return find_preset("F6b").parameters


def value_of(row):
    """Any legal value of a parameter."""
    if row["integer"]:
        return st.integers(row["low"], row["high"])
    return st.floats(row["low"], row["high"])


any_parameters = st.builds(GrowthParameters, **{row["name"]: value_of(row) for row in TABLE})


# ---------------------------------------------------------------- ranges


def test_there_are_24_in_the_order_of_table_1():
    assert [row["symbol"] for row in TABLE] == SYMBOLS
    assert [field.name for field in dataclasses.fields(GrowthParameters)] == [row["name"] for row in TABLE]
    assert len({row["name"] for row in TABLE}) == 24


@pytest.mark.parametrize("row", TABLE, ids=SYMBOLS)
def test_ends_of_the_range_are_legal_and_what_lies_beyond_is_named(row):
    low, high, name = row["low"], row["high"], row["name"]
    for good in (low, high, np.float64(low), np.float64(high)):
        assert getattr(base().replace(**{name: good}), name) == pytest.approx(good)
    for bad in (math.nextafter(low, -math.inf), math.nextafter(high, math.inf), -1e300, math.inf, -math.inf):
        if row["integer"] and math.isfinite(bad):
            bad = math.floor(bad) if bad < low else math.ceil(bad)
        with pytest.raises(InputError, match=f"{re.escape(name)} .{row['symbol']}.") as caught:
            base().replace(**{name: bad})
        said = str(caught.value)
        assert f"from {low} to {high}" in said
        assert said.endswith((f"got {float(bad)!r}", f"got {bad!r}"))
        assert "\n" not in said
        if row["unit"] and not row["integer"]:
            assert row["unit"] in said
    with pytest.raises(InputError, match=f"{name} .{row['symbol']}. must be .*got nan"):
        base().replace(**{name: math.nan})


@pytest.mark.parametrize("row", TABLE, ids=SYMBOLS)
@pytest.mark.parametrize("bad", [None, "0.5", True, [1], {}, 1j], ids=repr)
def test_what_is_no_number(row, bad):
    match = re.escape(f"{row['name']} ({row['symbol']}) must be a number, got {bad!r}")
    with pytest.raises(InputError, match=match):
        base().replace(**{row["name"]: bad})


def test_lateral_buds_are_whole():
    with pytest.raises(
        InputError, match=r"n_lateral_buds \(NLB\) must be a whole number from 0 to 8, got 1.5"
    ):
        base().replace(NLB=1.5)
    assert isinstance(base().replace(NLB=3.0).n_lateral_buds, int)
    assert isinstance(base().replace(GR=3).growth_rate, float)


def test_parameters_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        base().growth_rate = 3.0


def test_replace_takes_names_and_symbols():
    p = base().replace(GR=3, internode_length=0.2)
    assert (p.growth_rate, p.internode_length) == (3.0, 0.2)
    assert p.replace(GR=1.9, IBL=0.49) == base()
    with pytest.raises(InputError, match="there is no growth parameter 'nonsense'"):
        base().replace(nonsense=1)


def test_symbols_there_and_back():
    assert list(base().symbols()) == SYMBOLS
    assert GrowthParameters.from_symbols(base().symbols()) == base()


def test_from_symbols_names_what_is_missing_or_unknown():
    values = base().symbols()
    with pytest.raises(InputError, match=r"there is no growth parameter 'AAX'; did you mean 'AAV'\?"):
        GrowthParameters.from_symbols(values | {"AAX": 1})
    with pytest.raises(InputError, match=r"there is no growth parameter '#'$"):
        GrowthParameters.from_symbols(values | {"#": 1})
    del values["GR"]
    with pytest.raises(InputError, match=r"1 of 24 growth parameters are missing: GR$"):
        GrowthParameters.from_symbols(values)
    with pytest.raises(
        InputError, match=r"24 of 24 growth parameters are missing: AAV, NLB, BAM, BAV, RAM \.\.\."
    ):
        GrowthParameters.from_symbols({})


def test_the_docs_have_every_parameter_with_its_range(request):
    text = (request.config.rootpath / "docs" / "growth.md").read_text(encoding="utf-8")
    rows = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 5 and "`" in cells[1]:
            symbols, names = cells[0].split(", "), re.findall(r"`(\w+)`", cells[1])
            ranges = cells[3].split(", ")
            for k, (symbol, name) in enumerate(zip(symbols, names, strict=True)):
                rows[symbol] = (name, ranges[min(k, len(ranges) - 1)])
    for row in TABLE:
        assert rows[row["symbol"]] == (row["name"], f"{row['low']} to {row['high']}")
        assert f"{row['symbol']}" in GrowthParameters.__doc__
        assert f"{row['low']} to {row['high']}" in GrowthParameters.__doc__


# ---------------------------------------------------------------- presets


@pytest.mark.parametrize(("column", "name"), enumerate(["F6a", "F6b", "F6c", "F6d", "F6f"], 1))
def test_presets_are_table_2(column, name):
    rows = [line.split() for line in TABLE_2.strip().splitlines()]
    printed = {row[0]: float(row[column]) for row in rows}
    preset = find_preset(name)
    assert preset.age == printed.pop("t")
    assert preset.parameters.symbols() == printed
    assert len(printed) == 24
    assert preset.what


def test_f6e_is_the_printed_column_moved_down():
    preset = find_preset("F6e")
    found = preset.parameters.symbols()
    between = SYMBOLS[SYMBOLS.index("BAM") : SYMBOLS.index("PT") + 1]
    assert [found[symbol] for symbol in between] == F6E_PRINTED
    assert (found["AAV"], found["NLB"], found["GBA"], preset.age) == (2, 2, 0.78, 10)
    chosen = [found[symbol] for symbol in ("GT", "PF", "LB_PF", "GBS")]
    printed = [0.15, 0.22, 1.11, 0.32, 0.12]
    assert chosen == [value for value in printed if value in chosen]  # some of the printed, in their order


def test_presets_by_name():
    assert list(presets()) == ["F6a", "F6b", "F6c", "F6d", "F6e", "F6f"]
    assert find_preset("f6C") is find_preset("F6c")
    with pytest.raises(InputError, match=r"there is no preset 'oak'; there are F6a, F6b, F6c, F6d, F6e, F6f"):
        find_preset("oak")
    with pytest.raises(InputError, match=r"there is no preset 3"):
        find_preset(3)


# ---------------------------------------------------------------- files


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("kinds") / "kind.toml"


@given(any_parameters, st.integers(0, 200), st.text(), st.text())
def test_what_is_written_is_read_back(path, parameters, age, name, what):
    preset = Preset(name, parameters, age, what)
    path.write_bytes(format_growth(preset).encode("utf-8", "surrogatepass"))
    if any("\ud800" <= letter <= "\udfff" for letter in name + what):
        with pytest.raises(FormatError, match="not a TOML file of growth parameters"):
            read_growth(path)
        return
    back = read_growth(path)
    assert back.parameters == parameters
    assert (back.age, back.what) == (age, what)
    assert back.name == (name or "kind")


def write(path, text):
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def good(**changes):
    """A file by the paper's symbols, with some lines changed or (None) left out."""
    values = {"age": "12"} | {symbol: str(value) for symbol, value in base().symbols().items()} | changes
    return "".join(f"{key} = {value}\n" for key, value in values.items() if value is not None)


def test_thickness_of_wood_goes_along_where_it_is_not_the_usual(path):
    thick = Preset("kind", base(), 12, tip_share=0.05)
    assert read_growth(write(path, format_growth(thick))) == thick
    assert "tip_share" not in format_growth(Preset("kind", base(), 12))
    for value in ("0.3", "0", "nan", '"thick"', "true"):
        with pytest.raises(InputError, match="tip_share must be a number from 0.0005 to 0.2, got"):
            read_growth(write(path, good(tip_share=value)))


def test_symbols_and_names_at_the_top_or_in_a_table(path):
    plain = read_growth(write(path, good()))
    assert plain == Preset("kind", base(), 12)
    named = read_growth(
        write(path, "[growth]\n" + good(GR=None, growth_rate="1.9", name='"Oak"', what='"big"'))
    )
    assert named == Preset("Oak", base(), 12, "big")
    beside = "colour = 3\n[leaves]\nsize = 0.1\n[growth]\n" + good()
    assert read_growth(str(write(path, beside))).parameters == base()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (good(GR="99"), r"growth_rate \(GR\) must be from 0 to 12 internodes per cycle, got 99.0"),
        (good(GR='"1.9"'), r"growth_rate \(GR\) must be a number, got '1.9'"),
        (good(GR="[1, 2]"), r"growth_rate \(GR\) must be a number, got \[1, 2\]"),
        (good(GR="true"), r"growth_rate \(GR\) must be a number, got True"),
        (good(GR="{a = 1}"), r"growth_rate \(GR\) must be a number, got \{'a': 1\}"),
        (good(GR="nan"), r"growth_rate \(GR\) must be from 0 to 12 .*got nan"),
        (good(GR="1979-05-27"), r"growth_rate \(GR\) must be a number, got datetime.date"),
        (good(NLB="2.5"), r"n_lateral_buds \(NLB\) must be a whole number from 0 to 8, got 2.5"),
        (good(NLB="inf"), r"n_lateral_buds \(NLB\) must be .*got inf"),
        (good(NLB="nan"), r"n_lateral_buds \(NLB\) must be .*got nan"),
        (good(GR="9" * 400), r"growth_rate \(GR\) must be from 0 to 12 .*, got inf"),
        (good(NLB="-" + "9" * 400), r"n_lateral_buds \(NLB\) must be a whole number from 0 to 8, got -9"),
        (good(GR=None), r"1 of 24 growth parameters are missing: growth_rate"),
        (good(GR=None, IBL=None), r"2 of 24 growth parameters are missing: growth_rate, internode_length"),
        (good(grwth_rate="1"), r"there is no growth parameter 'grwth_rate'; did you mean 'growth_rate'\?"),
        (good(growth_rate="1.9"), r"a growth parameter is given twice, by its name and by its symbol"),
        (good(age=None), r"age is missing: the number of growth cycles, as in `age = 20`"),
        (good(age="-3"), r"age must be from 0 to 200 growth cycles, got -3"),
        (good(age="2.5"), r"age must be a whole number of growth cycles, got 2.5"),
        (good(age='"old"'), r"age must be a whole number of growth cycles, got 'old'"),
        ("growth = 3", r"must be a table of growth parameters"),
        ("[[growth]]\nage = 3", r"must be a table of growth parameters"),
        ("", r"age is missing"),
        ("[growth]\n", r"age is missing"),
        ("age = 3", r"24 of 24 growth parameters are missing"),
    ],
)
def test_files_with_wrong_values(path, text, message):
    with pytest.raises(InputError, match=rf"^{re.escape(str(path))}: .*{message}") as caught:
        read_growth(write(path, text))
    assert "\n" not in str(caught.value)
    assert not isinstance(caught.value, FormatError)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x00\x01\xff\xfe" * 50, "not a TOML file of growth parameters"),
        (b"\xff\xfea\x00g\x00e\x00", "not a TOML file of growth parameters"),
        (b"age = ", "not a TOML file of growth parameters"),
        (b"age = 3\nage = 4", "not a TOML file of growth parameters"),
        (b"age = " + b"9" * 9000, "not a TOML file of growth parameters"),
        (b"a = " + b"[" * 40_000, "not a TOML file of growth parameters"),
        (b"a = " + b"{b = " * 15_000, "not a TOML file of growth parameters"),
        (b"#" * 100_001, "larger than 100000 bytes; growth parameters are a short TOML file"),
    ],
    ids=["binary", "UTF-16", "cut off", "twice", "long number", "nested lists", "nested tables", "huge"],
)
def test_files_that_are_no_parameters(path, content, message):
    with pytest.raises(FormatError, match=rf"^{re.escape(str(path))}: .*{message}") as caught:
        read_growth(write(path, content))
    assert len(str(caught.value)) < 1000


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.toml: there is no such file\."):
        read_growth(tmp_path / "nowhere.toml")
    with pytest.raises(InputError, match=r": the file cannot be read \(Is a directory\)\."):
        read_growth(tmp_path)


@given(st.binary(max_size=200))
def test_no_bytes_crash_the_reader(path, content):
    path.write_bytes(content)
    with pytest.raises(SapwoodError):
        read_growth(path)


@given(
    st.dictionaries(
        st.sampled_from(["age", "name", "what", "AAV", "GR", "x"]), st.integers() | st.text(), min_size=1
    )
)
def test_no_values_crash_the_reader(path, values):
    import json

    path.write_text(
        "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items()), encoding="utf-8"
    )
    with pytest.raises(SapwoodError):
        read_growth(path)
