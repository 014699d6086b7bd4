"""Files of models: the same bytes back, and whatever is wrong with a file is a FormatError."""

import hashlib
import json
import math
import re
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.class_problems import mixed
from classify import BoostSettings, decode_model, encode_model, read_model, train_model, write_model
from classify.model_file import MAX_BYTES
from treegraph import FormatError, InputError

NAMES = ("ash", "birch", "chêne", "elm", "fir", "oak")


def make(n_classes=6, **options):
    x, y = mixed(6, n_classes, 8, seed=1)
    x[y == 1, 5] = np.nan  # a feature that one species never has
    return train_model(
        x,
        [NAMES[k] for k in y],
        [f"feature {k}" for k in range(8)],
        rng=np.random.default_rng(0),
        settings=BoostSettings(n_rounds=12, max_features=0.5),
        **({"name": "six", "provenance": {"seed": "0", "data": "nowhere"}} | options),
    ).model


@pytest.fixture(scope="module")
def model():
    return make()


@pytest.fixture(scope="module")
def data(model):
    return encode_model(model)


def sign(document):
    """The bytes of a document whose checksum is right, whatever else is not."""
    text = json.dumps(document["model"], sort_keys=True, separators=(",", ":"))
    document["sha256"] = hashlib.sha256(text.encode()).hexdigest()
    return json.dumps(document).encode()


def same(one, other):
    """Whether two models are the same in every byte of what they hold and say."""
    x = mixed(20, 6, 8, seed=2)[0]
    a, b = one.classify(x), other.classify(x)
    return (
        all(
            getattr(a, key).tobytes() == getattr(b, key).tobytes()
            for key in ("probability", "distance", "score", "is_unknown")
        )
        and repr(one.explain(x[0])) == repr(other.explain(x[0]))  # NaN is not NaN
        and encode_model(one) == encode_model(other)
    )


# ---------------------------------------------------------------- there and back


@pytest.mark.parametrize("n_classes", [2, 3, 6])
def test_a_model_comes_back_in_every_byte(n_classes, tmp_path):
    model = make(n_classes)
    write_model(tmp_path / "trees.json", model)
    back = read_model(tmp_path / "trees.json")
    assert same(model, back)
    for key in ("name", "version", "classes", "features", "temperature", "rejection", "provenance"):
        assert getattr(back, key) == getattr(model, key)
    np.testing.assert_array_equal(back.span.centre, model.span.centre)
    assert np.isnan(back.span.centre[1, 5])
    assert [path.name for path in tmp_path.iterdir()] == ["trees.json"]


def test_the_file_is_readable_text_and_small(data):
    text = data.decode("ascii")
    document = json.loads(text)
    assert document["format"] == "sapwood species model" and document["format_version"] == 1
    assert document["model"]["classes"] == list(NAMES)
    assert len(document["model"]["stumps"]["shared"]) == 12
    assert max(len(line) for line in text.splitlines()) < 2000 and len(data) < 10_000


def test_a_model_without_stumps_comes_back():
    model = train_model(
        np.zeros((6, 1)),
        ["a", "a", "b", "b", "c", "c"],
        ["nothing"],
        rng=np.random.default_rng(0),
    ).model
    assert model.stumps.n_stumps == 0
    back = decode_model(encode_model(model))
    np.testing.assert_array_equal(back.probabilities([[0.0]]), model.probabilities([[0.0]]))
    assert encode_model(back) == encode_model(model)


def test_a_model_too_large_is_not_written():
    model = make(provenance={f"note {k}": "x" * 2000 for k in range(4100)})
    with pytest.raises(
        InputError, match="a model must take at most 8000000 bytes, got 8[0-9]{6}; train with"
    ):
        encode_model(model)


# ---------------------------------------------------------------- damage


def test_every_damaged_byte_is_found_or_changes_nothing(model, data):
    rng = np.random.default_rng(0)
    for at in rng.choice(len(data), 400, replace=False):
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        try:
            back = decode_model(bytes(damaged))
        except FormatError:
            continue
        assert encode_model(back) == data  # a space became another one


def test_every_truncation_is_found(data):
    whole = data.rstrip()
    for size in [0, 1, 2, 10, *range(50, len(whole), 97), len(whole) - 1]:
        with pytest.raises(FormatError):
            decode_model(whole[:size])


@given(st.binary(max_size=300))
@settings(max_examples=150)
def test_any_bytes_are_a_format_error(junk):
    with pytest.raises(FormatError):
        decode_model(junk)


LEAVES = (
    st.none()
    | st.booleans()
    | st.integers(-(2**70), 2**70)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=5)
    | st.sampled_from([[], {}, [[]], [None], "01" * 6, 0, -1, 1e308])
)


def places(value, path=()):
    """Every path to a value in a document of lists and objects; of long lists the first three entries."""
    yield path
    if isinstance(value, dict):
        for key in value:
            yield from places(value[key], (*path, key))
    elif isinstance(value, list):
        for k in range(min(len(value), 3)):
            yield from places(value[k], (*path, k))


def change(document, path, new):
    at = document
    for step in path[:-1]:
        at = at[step]
    at[path[-1]] = new


@given(draw=st.data())
@settings(max_examples=200, deadline=None)
def test_a_signed_file_with_any_value_changed_is_refused_or_a_valid_model(data, draw):
    """The checksum protects nobody from a person who makes one: every value has to be checked."""
    document = json.loads(data)
    path = draw.draw(st.sampled_from([path for path in places(document["model"]) if path]))
    change(document["model"], path, draw.draw(LEAVES))
    try:
        model = decode_model(sign(document))
    except FormatError as error:
        assert "\n" not in str(error)
        return
    said = model.classify(mixed(2, 6, 8)[0])
    assert np.isfinite(said.probability).all()
    np.testing.assert_allclose(said.probability.sum(axis=1), 1.0)
    encode_model(model)


@given(draw=st.data())
@settings(max_examples=100, deadline=None)
def test_a_signed_file_with_any_entry_missing_or_twice_is_refused(data, draw):
    document = json.loads(data)
    paths = [path for path in places(document["model"]) if path and path[0] != "provenance"]
    path = draw.draw(st.sampled_from(paths))
    parent = document["model"]
    for step in path[:-1]:
        parent = parent[step]
    if isinstance(parent, list) and draw.draw(st.booleans()):
        parent.append(parent[path[-1]])
    else:
        del parent[path[-1]]
    with pytest.raises(FormatError):
        decode_model(sign(document))


# ---------------------------------------------------------------- hostile files


def model_with(data, *changes):
    document = json.loads(data)
    for path, new in changes:
        change(document["model"], path, new)
    return sign(document)


@pytest.mark.parametrize(
    "path, new, message",
    [
        (("classes",), "ash", "model.classes must be a list of 2 to 10000 entries, got str"),
        (("classes",), ["ash"], "model.classes must be a list of 2 to 10000 entries, got 1"),
        (("classes", 0), 7, "model.classes must hold texts, got int"),
        (("classes", 0), "birch", "classes must differ from each other, but 'birch' comes twice; the file"),
        (("features", 0), "a\nb", "features must be 1 to 200 printable characters"),
        (("features",), [], "model.features must be a list of 1 to 10000 entries, got 0"),
        (("name",), None, "model.name must be a text, got NoneType"),
        (("name",), "", "name must be 1 to 200 printable characters, got ''; the file is damaged"),
        (("temperature",), "1.0", "model.temperature must hold numbers, got \"'1.0'\""),
        (("temperature",), True, "model.temperature must hold numbers, got True"),
        (("temperature",), -1.0, "temperature must be from 0.001 to 1000.0, got -1.0; the file is damaged"),
        (("temperature",), 10**400, "model.temperature must hold numbers, got 1000"),
        (("rejection",), [], "model.rejection must have the fields score_min, .*, got list"),
        (("rejection", "n_measured"), 1.5, "n_measured must hold whole numbers from 0 to 2.31 - 1, got 1.5"),
        (("rejection", "n_measured"), 2**31, "n_measured must hold whole numbers"),
        (("rejection", "distance_max"), 9.0, "distance_max must be from 0.0 to 5.0, got 9.0"),
        (("stumps", "feature", 0), 8, "feature must be from 0 to 7, got 8; 1 of 12 break this"),
        (("stumps", "feature", 0), -1, "model.stumps.feature must hold whole numbers"),
        (("stumps", "feature", 0), 1.0, "model.stumps.feature must hold whole numbers"),
        (("stumps", "feature"), [0] * 11, "model.stumps.shared must be a list of 11 to 11 entries, got 12"),
        (("stumps", "threshold", 3), None, "model.stumps.threshold must hold numbers, got NoneType"),
        (("stumps", "threshold", 3), [1.0], "model.stumps.threshold must hold numbers, got list"),
        (("stumps", "missing_above"), "01", "model.stumps.missing_above must be 12 characters 0 or 1"),
        (("stumps", "missing_above"), "2" * 12, "missing_above must be 12 characters 0 or 1, got '2222"),
        (("stumps", "shared", 0), "0101010", "model.stumps.shared must be 6 characters 0 or 1"),
        (("stumps", "shared", 0), [0, 1], "model.stumps.shared must be 6 characters 0 or 1, got list"),
        (("stumps", "constant", 0), [0.0] * 7, r"constant\[0\] must hold . numbers, one per other class"),
        (("stumps", "constant", 0), 0.0, r"constant\[0\] must hold . numbers, one per other class"),
        (("stumps", "above_share", 0), 2.0, "above_share must be from 0.0 to 1.0, got 2.0"),
        (("span", "centre", 0), [0.0], "model.span.centre must have rows of 8 numbers"),
        (("stumps", "above", 0), 1e308, "above must be from -1.0 to 1.0, got 1e.308; 1 of 12 break this"),
        (("span", "spread", 0, 0), None, "model.span.spread must hold numbers, got NoneType"),
        (("span", "spread", 0, 0), 0.0, "spread must be from 1e-100 to 1e.100, got 0.0"),
        (("provenance",), ["x"], "model.provenance must be an object, got list"),
        (("provenance", "seed"), {"a": 1}, "provenance must be 1 to 2000 printable characters"),
        (("more",), 1, "model must have the fields name, version, .*, got classes, features, more"),
    ],
)
def test_what_is_wrong_is_named(data, path, new, message):
    with pytest.raises(FormatError, match=message.replace("got \"'1.0'\"", "got '1.0'")):
        decode_model(model_with(data, (path, new)))


def test_another_file_or_version_is_named(data):
    for junk in (b"[]", b"{}", b"7", b'{"format": "other"}', b'{"format": []}'):
        with pytest.raises(FormatError, match='must begin with "format": "sapwood species model"; this is'):
            decode_model(junk)
    document = json.loads(data)
    for version in (2, "1", 1.0, True, [[]], None):
        document["format_version"] = version
        with pytest.raises(FormatError, match="format_version must be 1, got .*; a newer version"):
            decode_model(json.dumps(document).encode())
    del document["model"]
    document["format_version"] = 1
    with pytest.raises(
        FormatError, match="the file must have the fields format, format_version, sha256, model"
    ):
        decode_model(json.dumps(document).encode())


def test_an_edited_file_is_named(data):
    with pytest.raises(FormatError, match="the checksum must be that of the content; .* or was edited"):
        decode_model(data.replace(b'"six"', b'"sox"'))


@pytest.mark.parametrize(
    "junk, message",
    [
        (b"\xff\xfe{}", "a model must be JSON in UTF-8"),
        (b"PK\x03\x04" + bytes(100), "a model must be JSON in UTF-8"),  # a zip archive, as .npz is
        (b"\x80\x04\x95cposix\nsystem\n.", "a model must be JSON in UTF-8"),  # a pickle
        (b'{"a": 1, "a": 2}', "a key must not come twice in one object"),
        (b'{"a": NaN}', "numbers must be finite, got NaN"),
        (b'{"a": -Infinity}', "numbers must be finite, got -Infinity"),
        (b'{"a": 1e999}', "numbers must be finite, got 1e999"),
        (b'{"a": ' + b"9" * 10_000 + b"}", "a model must be JSON in UTF-8 .Exceeds the limit"),
        (b"[" * 200_000, "a model must not be nested deeply"),
        (b'{"a":' * 200_000, "a model must not be nested deeply"),
        (b"[" * 5_000_000 + b"]" * (MAX_BYTES - 5_000_000 + 1), "a model must take at most 8000000 bytes"),
    ],
    ids=lambda value: None if isinstance(value, str) else value[:12].hex(),
)
def test_hostile_text_is_a_format_error(junk, message):
    with pytest.raises(FormatError, match=message):
        decode_model(junk)


@pytest.mark.parametrize("path", [("provenance", "seed"), ("temperature",), ("stumps", "feature", 0)])
def test_depth_that_the_parser_still_follows_is_a_format_error(data, path):
    nested = []
    for _ in range(800):
        nested = [nested]
    with pytest.raises(FormatError):
        decode_model(model_with(data, (path, nested)))


def test_no_file_costs_much_memory(tmp_path):
    """What takes most room for its bytes: empty lists."""
    share = 10  # of a tenth of the most bytes, for the time it takes to trace
    junk = b'{"format": [' + b"[]," * (MAX_BYTES // 3 // share) + b"[]]}"
    tracemalloc.start()
    with pytest.raises(FormatError, match="this is another file"):
        decode_model(junk)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 300e6 / share
    huge = tmp_path / "huge.json"
    with open(huge, "wb") as file:
        file.truncate(10**12)  # a terabyte of nothing, of which 8 MB are read
    with pytest.raises(
        FormatError, match=f"^{re.escape(str(huge))}: a model must take at most 8000000 bytes, got more"
    ):
        read_model(huge)


def test_a_file_that_is_not_there_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_model(tmp_path / "none.json")


def test_numbers_keep_every_digit(data):
    values = [v for row in json.loads(data)["model"]["span"]["spread"] for v in row]
    assert all(isinstance(v, float) and math.isfinite(v) for v in values)
    assert any(len(re.sub(r"\D", "", repr(v))) >= 16 for v in values)
