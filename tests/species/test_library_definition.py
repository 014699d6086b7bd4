"""Definitions of species: what is read of a file, and everything that can be wrong with it."""

import os
import tomllib
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from species._art_shape import LeafColors, LeafShape
from species.barkart import BarkShape
from species.library import BladeRules, BranchletRules, Phenology, parse_definition, read_definition
from species.library import definition as module
from tests.library_examples import GRAMMAR, GROWTH, ROWAN, species_text, toml
from treegraph import Allometry
from treegraph.errors import FormatError, InputError

NEEDED = ("name", "latin", "leaf_area_density", "allometry", "branchlets", "leaf", "bark")


# ---------------------------------------------------------------- what is read


def test_every_entry_is_where_it_belongs():
    found = parse_definition(
        species_text(
            phenology__leaf_out=100, phenology__leaf_fall=300, blade__across=2, blade__along=3,
            leaf__fold_deg=20, bark__depth=0.004, leaf_colors__winter="#102030",
        )
    )  # fmt: skip
    assert (found.name, found.latin, found.also) == ("Rowan", "Sorbus aucuparia", ("mountain ash",))
    assert found.names == ("Rowan", "Sorbus aucuparia", "mountain ash")
    assert (found.what, found.leaf_area_density) == ("A small tree.", 2.5)
    assert found.allometry == Allometry(1.6, 1.5, 0.98)
    assert found.branchlets == BranchletRules(GRAMMAR, 4, (0.5, 1.0), (0.0, 60.0))
    assert found.leaf == LeafShape("simple", length=0.08, width=0.04, fold_deg=20)
    assert found.colors == LeafColors(summer=(70, 108, 44), winter=(16, 32, 48))
    assert found.bark == BarkShape("smooth", depth=0.004)
    assert found.blade == BladeRules(2, 3)
    assert found.phenology == Phenology(100, 140, 275, 300)
    assert (found.growth.name, found.growth.age) == ("Rowan", 12)
    assert found.growth.parameters.symbols() == {key: GROWTH[key] for key in GROWTH if key != "age"}
    assert repr(found) == "<Definition Rowan (Sorbus aucuparia)>"


def test_what_may_be_left_out_has_its_default():
    found = parse_definition(species_text(drop=("also", "what", "leaf_colors", "growth")))
    assert (found.also, found.what, found.growth) == ((), "", None)
    assert (found.colors, found.blade, found.phenology) == (LeafColors(), BladeRules(), Phenology())


@pytest.mark.parametrize("key", NEEDED)
def test_what_is_missing_is_named(key):
    with pytest.raises(InputError, match=f"^{key}: missing; a species needs name, latin, leaf_area_density"):
        parse_definition(species_text(drop=key))


def test_everything_that_is_missing_is_named_at_once():
    with pytest.raises(InputError, match="^name, bark: missing; a species needs"):
        parse_definition(species_text(drop=("name", "bark")))


@pytest.mark.parametrize(
    "drop, missing",
    [
        ("allometry__gamma", "[allometry] gamma: missing"),
        (("allometry__beta", "allometry__f_s"), "[allometry] beta, f_s: missing"),
        ("branchlets__grammar", "[branchlets] grammar: missing"),
        (("leaf__kind", "leaf__length"), "[leaf] kind, length: missing"),
        ("leaf__width", "[leaf] width is missing: a simple leaf needs width"),
        ("bark__kind", "[bark] kind: missing"),
        ("growth__age", "[growth] age is missing: the number of growth cycles, as in `age = 20`"),
        ("growth__PT", "[growth] 1 of 24 growth parameters are missing: phototropism"),
    ],
)
def test_what_a_table_lacks_is_named_with_the_table(drop, missing):
    with pytest.raises(InputError) as error:
        parse_definition(species_text(drop=drop))
    assert str(error.value) == missing


@pytest.mark.parametrize(
    "changes, text",
    [
        ({"lattin": "x"}, "there is no entry 'lattin'; did you mean 'latin'?"),
        ({"leafs__kind": "simple"}, "there is no entry 'leafs'; did you mean 'leaf'?"),
        ({"zzzzzz": 1}, "there is no entry 'zzzzzz'; there are name, latin, leaf_area_density"),
        ({"allometry__betta": 1}, "[allometry] there is no entry 'betta'; did you mean 'beta'?"),
        ({"allometry__d_root": 1}, "[allometry] there is no entry 'd_root'"),
        ({"branchlets__sizes": [1, 2]}, "[branchlets] there is no entry 'sizes'; did you mean 'size'?"),
        ({"leaf__lenght": 1}, "[leaf] there is no entry 'lenght'; did you mean 'length'?"),
        ({"leaf_colors__fall": 1}, "[leaf_colors] there is no entry 'fall'"),
        ({"bark__colour": 1}, "[bark] there is no entry 'colour'; did you mean 'color'?"),
        ({"blade__accross": 1}, "[blade] there is no entry 'accross'; did you mean 'across'?"),
        ({"phenology__leafout": 1}, "[phenology] there is no entry 'leafout'; did you mean 'leaf_out'?"),
        ({"growth__phototropisms": 1}, "[growth] there is no growth parameter 'phototropisms'; did you mean"),
    ],
)
def test_an_unknown_entry_has_a_suggestion(changes, text):
    with pytest.raises(InputError) as error:
        parse_definition(species_text(**changes))
    assert str(error.value).startswith(text)


@pytest.mark.parametrize("name", module.TABLES)
@pytest.mark.parametrize("value", [3, "willow", [1, 2], True, 1.5])
def test_something_else_where_a_table_is_wanted(name, value):
    with pytest.raises(InputError) as error:
        parse_definition(species_text(**{name: value}))
    assert str(error.value).startswith(f"[{name}] must be a table")
    assert str(error.value).endswith(f"got {value!r}")


@pytest.mark.parametrize(
    "changes, text",
    [
        ({"name": 3}, "name must be a name of 1 to 80 printable characters with a letter, got 3"),
        ({"name": "  "}, "name must be a name"),
        ({"name": "-_-"}, "name must be a name"),
        ({"name": "a\tb"}, "name must be a name"),
        ({"name": "\u202eoak"}, "name must be a name"),
        ({"name": "x" * 81}, "name must be a name"),
        ({"latin": ["Quercus"]}, "latin must be a name"),
        ({"also": "oak"}, "also must be a list of at most 40 names, got 'oak'"),
        ({"also": ["oak"] * 41}, "also must be a list of at most 40 names"),
        ({"also": ["oak", 3]}, "also must be a name of 1 to 80"),
        ({"also": [["oak"]]}, "also must be a name of 1 to 80"),
        ({"what": 3}, "what must be one line of text, got 3"),
        ({"what": "two\nlines"}, "what must be one line of text"),
        ({"leaf_area_density": 0}, "leaf_area_density must be above 0 and at most 50 m2/m3, got 0"),
        ({"leaf_area_density": 51}, "leaf_area_density must be above 0 and at most 50 m2/m3, got 51"),
        ({"leaf_area_density": "2"}, "leaf_area_density must be above 0 and at most 50 m2/m3, got '2'"),
        ({"leaf_area_density": True}, "leaf_area_density must be above 0"),
        ({"leaf_area_density": float("nan")}, "leaf_area_density must be above 0"),
        ({"leaf_area_density": float("inf")}, "leaf_area_density must be above 0"),
        ({"leaf_area_density": 10**400}, "leaf_area_density must be above 0"),
        ({"allometry__beta": 0.5}, "[allometry] beta must be a finite number >= 1, got 0.5"),
        ({"allometry__beta": "1.5"}, "[allometry] beta must be a number, got '1.5'"),
        ({"allometry__beta": [1.5]}, "[allometry] beta must be a number, got [1.5]"),
        ({"allometry__gamma": True}, "[allometry] gamma must be a number, got True"),
        ({"allometry__f_s": 1.5}, "[allometry] f_s must be above 0 and at most 1, got 1.5"),
        ({"allometry__f_s": float("nan")}, "[allometry] f_s must be above 0"),
        ({"allometry__gamma": 10**400}, "[allometry] gamma is too large a number, got 1000"),
        ({"branchlets__grammar": ""}, "[branchlets] grammar must be the text of an L-system"),
        ({"branchlets__grammar": 5}, "[branchlets] grammar must be the text of an L-system"),
        ({"branchlets__count": 0}, "[branchlets] count must be from 1 to 60 branchlets, got 0"),
        ({"branchlets__count": 61}, "[branchlets] count must be from 1 to 60 branchlets, got 61"),
        ({"branchlets__count": 4.0}, "[branchlets] count must be a whole number of branchlets, got 4.0"),
        ({"branchlets__count": True}, "[branchlets] count must be a whole number of branchlets, got True"),
        ({"branchlets__size": [1, 0.5]}, "[branchlets] size must be two ascending numbers from 0.001 to 100"),
        ({"branchlets__size": [0, 1]}, "[branchlets] size must be two ascending numbers"),
        ({"branchlets__size": 1}, "[branchlets] size must be two ascending numbers from 0.001 to 100, got 1"),
        ({"branchlets__size": "12"}, "[branchlets] size must be two ascending numbers"),
        ({"branchlets__size": ["1", "2"]}, "[branchlets] size must be two ascending numbers"),
        ({"branchlets__size": [True, True]}, "[branchlets] size must be two ascending numbers"),
        ({"branchlets__size": [1, 2, 3]}, "[branchlets] size must be two ascending numbers"),
        ({"branchlets__size": {1: 1, 2: 1}}, "[branchlets] size must be two ascending numbers"),
        ({"branchlets__size": [1, float("nan")]}, "[branchlets] size must be two ascending numbers"),
        ({"branchlets__size": [1, 10**400]}, "[branchlets] size must be two ascending numbers"),
        ({"branchlets__slope_deg": [-91, 0]}, "[branchlets] slope_deg must be two ascending numbers"),
        ({"leaf__kind": "round"}, "[leaf] kind must be one of simple, linear"),
        ({"leaf__length": 10**400}, "[leaf] length is too large a number"),
        ({"leaf__length": "8 cm"}, "[leaf] length must be from 0.003 to 8 metres, got '8 cm'"),
        ({"leaf__leaflets": True}, "[leaf] leaflets must be a whole number"),
        ({"leaf_colors__summer": [1, 2, 300]}, "[leaf_colors] summer must be three sRGB numbers"),
        ({"leaf_colors__summer": "green"}, "[leaf_colors] summer must be three sRGB numbers"),
        ({"bark__count": 1.5}, "[bark] count must be a whole number from 1 to 40, got 1.5"),
        ({"blade__across": 3}, "[blade] across must be a whole number from 1 to 2, got 3"),
        ({"blade__along": True}, "[blade] along must be a whole number from 1 to 8, got True"),
        ({"blade__along": 2.0}, "[blade] along must be a whole number from 1 to 8, got 2.0"),
        ({"phenology__summer": 105}, "[phenology] leaf_out, summer, autumn and leaf_fall must be ascending"),
        ({"phenology__leaf_fall": 366}, "[phenology] leaf_out, summer, autumn and leaf_fall must be"),
        ({"phenology__leaf_out": 1.0}, "[phenology] leaf_out, summer, autumn and leaf_fall must be"),
        ({"phenology__leaf_out": True}, "[phenology] leaf_out, summer, autumn and leaf_fall must be"),
        ({"growth__age": 201}, "[growth] age must be from 0 to 200 growth cycles, got 201"),
        ({"growth__age": True}, "[growth] age must be a whole number of growth cycles, got True"),
        ({"growth__GR": 13}, "[growth] growth_rate (GR) must be from 0 to 12 internodes per cycle, got 13"),
        ({"growth__growth_rate": 1}, "[growth] a growth parameter is given twice"),
    ],
)  # fmt: skip
def test_every_rule_is_checked_and_named(changes, text):
    with pytest.raises(InputError) as error:
        parse_definition(species_text(**changes))
    said = str(error.value)
    assert said.startswith(text)
    assert "\n" not in said and len(said) <= module.LONGEST_MESSAGE


@pytest.mark.parametrize(
    "text, match",
    [
        ("name = 'Oak", "^not a TOML file of a species \\(Unterminated string|^not a TOML file of a species"),
        ("name = 'Oak'\nname = 'Elm'", r"^not a TOML file of a species \(Cannot overwrite a value"),
        ("=", "^not a TOML file of a species"),
        ("\0", "^not a TOML file of a species"),
        ("a = " + "[" * 5000 + "]" * 5000, "^not a TOML file of a species"),
        ("a = " + "{x=" * 5000 + "1" + "}" * 5000, "^not a TOML file of a species"),
        ("a = " + "1" * 5000, "^not a TOML file of a species"),
        ("x" * 50_000 + " = 1", "^there is no entry 'xxxx"),
        ("leaf." * 200 + "a = 1", "missing"),
        ("", "^name, latin, leaf_area_density, allometry, branchlets, leaf, bark: missing"),
        ("a = 1979-05-27", "there is no entry 'a'"),
    ],
)
def test_what_is_no_species_is_said_in_one_short_line(text, match):
    with pytest.raises((InputError, FormatError), match=match) as error:
        parse_definition(text)
    assert "\n" not in str(error.value) and len(str(error.value)) <= module.LONGEST_MESSAGE


def test_nesting_that_can_be_read_is_refused_all_the_same():
    for depth in (10, 100, 300, 900):
        for key in ("what", "also", "leaf_area_density", "name"):
            text = species_text(drop=key)
            with pytest.raises((InputError, FormatError)):
                parse_definition(f"{key} = {'[' * depth}{']' * depth}\n{text}")


# ---------------------------------------------------------------- files


def test_a_file_is_read_as_its_text_is(tmp_path):
    path = tmp_path / "rowan.toml"
    text = species_text(latin="Sorbus aucupária")
    path.write_text(text, encoding="utf-8")
    found = read_definition(path)
    assert found == parse_definition(text)
    assert found.text == text
    windows = tmp_path / "windows.toml"  # with a mark before the text and other ends of lines
    windows.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode("utf-8"))
    assert read_definition(windows) == found
    assert read_definition(str(path)) == found


@pytest.mark.parametrize(
    "data, kind, match",
    [
        (b"name = 3", InputError, "latin, leaf_area_density"),
        (b"name = ", FormatError, "not a TOML file of a species"),
        (b"\xff\xfe\x00", FormatError, "not a TOML file of a species .*utf-8"),
        (b"# " + b"x" * 100_000, FormatError, "larger than 100000 bytes; a species is a short TOML file"),
    ],
)
def test_what_is_wrong_begins_with_the_path(tmp_path, data, kind, match):
    path = tmp_path / "wrong.toml"
    path.write_bytes(data)
    with pytest.raises(kind, match=match) as error:
        read_definition(path)
    assert str(error.value).startswith(f"{path}: ")


def test_what_is_no_file_is_said(tmp_path):
    with pytest.raises(InputError, match="none.toml: there is no such file."):
        read_definition(tmp_path / "none.toml")
    with pytest.raises(InputError, match="this is not a file; name a species' TOML file."):
        read_definition(tmp_path)
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(InputError, match="pipe.toml: this is not a file"):
        read_definition(tmp_path / "pipe.toml")  # and does not wait for somebody to write to it


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read(tmp_path):
    path = tmp_path / "secret.toml"
    path.write_text(species_text())
    path.chmod(0)
    with pytest.raises(InputError, match=r"the file cannot be read \(Permission denied\)"):
        read_definition(path)


# ---------------------------------------------------------------- seasons


def test_seasons_change_on_their_days():
    year = Phenology(leaf_out=105, summer=140, autumn=275, leaf_fall=315)
    for day in range(1, 367):
        if day < 105 or day >= 315:
            wanted = "winter"
        elif day < 140:
            wanted = "spring"
        elif day < 275:
            wanted = "summer"
        else:
            wanted = "autumn"
        assert year.season(day) == wanted, day
    assert year.season(np.int64(200)) == "summer"


@pytest.mark.parametrize("day", [0, 367, -1, True, 1.5, "200", None])
def test_there_are_so_many_days(day):
    with pytest.raises(InputError, match="day must be a whole number from 1 to 366, got"):
        Phenology().season(day)


def test_who_is_bare():
    bare = parse_definition(species_text())
    green = parse_definition(species_text(leaf_colors__winter=[70, 100, 44]))
    assert [bare.is_bare(s) for s in ("spring", "summer", "autumn", "winter")] == [False, False, False, True]
    assert not green.is_bare("winter")
    with pytest.raises(InputError, match="season must be one of spring, summer, autumn, winter, got 'fall'"):
        bare.is_bare("fall")


# ---------------------------------------------------------------- anything at all

VALUES = st.recursive(
    st.none().map(lambda _: {})
    | st.booleans()
    | st.integers()
    | st.integers(-(10**400), 10**400)
    | st.floats()
    | st.text(max_size=12)
    | st.sampled_from(["simple", "needle", "bipinnate", "#102030", GRAMMAR, "ridged"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from("abxyz"), inner, max_size=3),
    max_leaves=5,
)
TABLE_KEYS = {
    "allometry": ("beta", "gamma", "f_s"),
    "branchlets": [entry.name for entry in fields(BranchletRules)],
    "leaf": [entry.name for entry in fields(LeafShape)],
    "leaf_colors": [entry.name for entry in fields(LeafColors)],
    "bark": [entry.name for entry in fields(BarkShape)],
    "blade": [entry.name for entry in fields(BladeRules)],
    "phenology": [entry.name for entry in fields(Phenology)],
    "growth": list(GROWTH),
}
ENTRIES = [key for key, value in ROWAN.items() if not isinstance(value, dict)]
ENTRIES += [f"{name}__{key}" for name, keys in TABLE_KEYS.items() for key in keys]
MORE = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def accepts(text):
    """Whether a text is a species; any error but ours is a failure."""
    try:
        found = parse_definition(text)
    except (InputError, FormatError) as error:
        assert "\n" not in str(error) and 0 < len(str(error)) <= module.LONGEST_MESSAGE
        return False
    assert found.text == text
    return True


@MORE
@given(st.dictionaries(st.sampled_from(ENTRIES), VALUES, min_size=1, max_size=3))
def test_no_value_crashes(changes):
    text = species_text(**changes)
    tomllib.loads(text)  # so that it is our own checks that are tested
    accepts(text)


@MORE
@given(st.sampled_from([*ROWAN, *ENTRIES]), VALUES)
def test_no_value_of_any_entry_crashes(key, value):
    accepts(species_text(**{key: value}))


@MORE
@given(st.text(alphabet=st.sampled_from("=[]{}\"'#\n. ,0e-\\\0a"), max_size=40))
def test_no_text_crashes(text):
    assert not accepts(text)


@MORE
@given(st.integers(0, 1500), st.text(max_size=5), st.integers(0, 30))
def test_no_typing_error_crashes(at, typed, removed):
    text = species_text()
    at %= len(text)
    accepts(text[:at] + typed + text[at + removed :])


@given(st.text(max_size=30))
def test_the_examples_are_written_as_toml(text):
    text = text.replace("'", "")
    assert tomllib.loads(f"a = {toml(text)}")["a"] == text
