"""Files of trained models: JSON that can be read without trust.

One line per array. Nothing in the file is executed, compressed, or allocated by a size that it declares:
the text is at most 8 MB, it is parsed as JSON, and every list is checked for its length, its type and its
range before it becomes an array. A checksum over the content finds damage. Numbers are written with as many
digits as a float needs to come back bit for bit, so a model that was read gives the same bytes.

The file is one object with ``format``, ``format_version``, ``sha256`` and ``model``; the checksum is that of
``model`` as JSON with sorted keys, no spaces, and everything but ASCII escaped. ``model`` has the attributes
of :class:`SpeciesModel`, and its parts those of :class:`Stumps`, :class:`FeatureRange` and
:class:`Rejection`, as lists, but:

- ``stumps.missing_above`` is a text of one 0 or 1 per stump, ``stumps.shared`` one such text per stump;
- ``stumps.constant`` has for each stump the constants of the classes that do not share it, in their order;
- ``span.centre`` has null for NaN.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classify.calibration import FeatureRange, Rejection
from classify.model import SpeciesModel
from classify.stumps import Stumps
from treegraph._files import write_whole
from treegraph.errors import FormatError, InputError

__all__ = [
    "FORMAT",
    "FORMAT_VERSION",
    "decode_model",
    "encode_model",
    "read_model",
    "shipped_model",
    "write_model",
]

FORMAT = "sapwood species model"
FORMAT_VERSION = 1

MAX_BYTES = 8_000_000
"""Most bytes of a file. A model of 12 species, 220 features and 600 stumps takes a quarter of a megabyte."""

SHIPPED = Path(__file__).parent / "shipped" / "species.model"

MAX_STUMPS, MAX_CLASSES, MAX_FEATURES = 100_000, 10_000, 10_000


def write_model(path: str | os.PathLike[str], model: SpeciesModel) -> None:
    """Write a model to a file that appears whole or not at all."""
    write_whole(path, encode_model(model))


def read_model(path: str | os.PathLike[str]) -> SpeciesModel:
    """Read a model; the file is not trusted.

    Raises
    ------
    FormatError
        If the file is too large, damaged, of a newer version, or no model.
    OSError
        If it cannot be read.
    """
    with open(path, "rb") as file:
        data = file.read(MAX_BYTES + 1)
    try:
        return decode_model(data)
    except FormatError as error:
        raise FormatError(f"{os.fspath(path)}: {error}") from error


@cache
def shipped_model() -> SpeciesModel:
    """The model that comes along: species of the library, learnt from virtual scans (docs/classify.md).

    Raises
    ------
    FormatError, OSError
        If the installation is damaged.
    """
    return read_model(str(SHIPPED))


def encode_model(model: SpeciesModel) -> bytes:
    """Return the bytes of a model's file; the same model gives the same bytes."""
    content = _content(model)
    lines = [f'{{"format": {json.dumps(FORMAT)},', f'"format_version": {FORMAT_VERSION},']
    lines.append(f'"sha256": "{_checksum(content)}",')
    lines.append('"model": {')
    for n, (key, value) in enumerate(content.items()):
        end = "," if n < len(content) - 1 else ""
        if isinstance(value, dict) and value:
            rows = [f" {json.dumps(name)}: {json.dumps(each)}" for name, each in value.items()]
            lines += [f"{json.dumps(key)}: {{", ",\n".join(rows), f"}}{end}"]
        else:
            lines.append(f"{json.dumps(key)}: {json.dumps(value)}{end}")
    data = ("\n".join(lines) + "\n}}\n").encode("ascii")
    if len(data) > MAX_BYTES:
        raise InputError(
            f"a model must take at most {MAX_BYTES} bytes, got {len(data)}; train with fewer rounds"
        )
    return data


def decode_model(data: bytes) -> SpeciesModel:
    """Return the model of a file's bytes, which are not trusted.

    Raises
    ------
    FormatError
        If there are too many of them, or they are damaged, of a newer version, or no model.
    """
    if len(data) > MAX_BYTES:
        raise FormatError(f"a model must take at most {MAX_BYTES} bytes, got more")
    try:
        return _decode(_parse(data))
    except RecursionError as error:
        raise FormatError("a model must not be nested deeply; the file is damaged") from error
    except InputError as error:
        raise FormatError(f"{error}; the file is damaged") from error


def _decode(document: Any) -> SpeciesModel:
    """Check what kind of file it is, and its checksum, before its content."""
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise FormatError(f'a model must begin with "format": "{FORMAT}"; this is another file')
    version = document.get("format_version")
    if type(version) is not int or version != FORMAT_VERSION:
        raise FormatError(
            f"format_version must be {FORMAT_VERSION}, got {_shown(version)}; "
            "a newer version of the program may read it"
        )
    _Section("the file", document, ("format", "format_version", "sha256", "model"))
    content = document["model"]
    if not isinstance(content, dict) or document["sha256"] != _checksum(content):
        raise FormatError("the checksum must be that of the content; the file is damaged, or was edited")
    return _model(_Section("model", content, MODEL_FIELDS))


def _shown(value: Any) -> str:
    """A value for a message: the beginning of a text or number, the type of anything else."""
    return repr(value)[:20] if isinstance(value, str | int | float) else type(value).__name__


MODEL_FIELDS = (
    "name",
    "version",
    "classes",
    "features",
    "temperature",
    "rejection",
    "stumps",
    "span",
    "provenance",
)
STUMP_FIELDS = (
    "intercept",
    "feature",
    "threshold",
    "missing_above",
    "above",
    "below",
    "shared",
    "constant",
    "above_share",
    "gain",
)
REJECTION_FIELDS = ("score_min", "distance_max", "asked", "measured", "n_measured")


def _content(model: SpeciesModel) -> dict[str, Any]:
    """The model in lists, numbers and texts, by :data:`MODEL_FIELDS`."""
    stumps = model.stumps
    rows = {name: getattr(stumps, name).tolist() for name in STUMP_FIELDS}
    rows["missing_above"] = _bits(stumps.missing_above)
    rows["shared"] = [_bits(row) for row in stumps.shared]
    rows["constant"] = [
        row[~shared].tolist() for row, shared in zip(stumps.constant, stumps.shared, strict=True)
    ]
    return {
        "name": model.name,
        "version": model.version,
        "classes": list(model.classes),
        "features": list(model.features),
        "temperature": model.temperature,
        "rejection": {name: getattr(model.rejection, name) for name in REJECTION_FIELDS},
        "stumps": rows,
        "span": {
            "centre": [[None if math.isnan(v) else v for v in row] for row in model.span.centre.tolist()],
            "spread": model.span.spread.tolist(),
        },
        "provenance": dict(model.provenance),
    }


def _bits(mask: NDArray[np.bool_]) -> str:
    return "".join("1" if each else "0" for each in mask)


def _checksum(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def _parse(data: bytes) -> Any:
    """Parse JSON that has no key twice and no infinities."""
    try:
        return json.loads(
            data.decode("utf-8"), object_pairs_hook=_object, parse_constant=_refuse, parse_float=_float
        )
    except FormatError:
        raise
    except ValueError as error:  # no JSON, or no UTF-8
        raise FormatError(
            f"a model must be JSON in UTF-8 ({str(error)[:80]}); the file is damaged"
        ) from error


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise FormatError("a key must not come twice in one object; the file is damaged")
    return found


def _refuse(name: str) -> None:
    raise FormatError(f"numbers must be finite, got {name}; the file is damaged")


def _float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise FormatError(f"numbers must be finite, got {text[:20]}; the file is damaged")
    return value


class _Section:
    """An object of the file with exactly the fields that are expected, read with their types checked."""

    def __init__(self, name: str, content: Any, fields: tuple[str, ...]) -> None:
        if not isinstance(content, dict) or set(content) != set(fields):
            got = ", ".join(sorted(content))[:80] if isinstance(content, dict) else type(content).__name__
            raise FormatError(f"{name} must have the fields {', '.join(fields)}, got {got}")
        self.name, self.content = name, content

    def section(self, key: str, fields: tuple[str, ...]) -> _Section:
        return _Section(f"{self.name}.{key}", self.content[key], fields)

    def items(self, key: str, least: int, most: int) -> list[Any]:
        """A list of `least` to `most` entries of any type."""
        found = self.content[key]
        if not isinstance(found, list) or not least <= len(found) <= most:
            got = f"{len(found)}" if isinstance(found, list) else type(found).__name__
            raise FormatError(f"{self.name}.{key} must be a list of {least} to {most} entries, got {got}")
        return found

    def text(self, key: str) -> str:
        found = self.content[key]
        if not isinstance(found, str):
            raise FormatError(f"{self.name}.{key} must be a text, got {type(found).__name__}")
        return found

    def texts(self, key: str, least: int, most: int) -> tuple[str, ...]:
        found = self.items(key, least, most)
        for each in found:
            if not isinstance(each, str):
                raise FormatError(f"{self.name}.{key} must hold texts, got {type(each).__name__}")
        return tuple(found)

    def number(self, key: str) -> float:
        return float(self._numbers(key, [self.content[key]], (1,))[0])

    def whole(self, key: str) -> int:
        return int(self._whole(key, [self.content[key]])[0])

    def vector(self, key: str, n: int) -> NDArray[np.float64]:
        return self._numbers(key, self.items(key, n, n), (n,))

    def wholes(self, key: str, n: int) -> NDArray[np.int32]:
        return self._whole(key, self.items(key, n, n))

    def matrix(self, key: str, rows: int, columns: int, *, may_miss: bool = False) -> NDArray[np.float64]:
        """A list of lists of numbers; null is NaN where it may be."""
        found = self.items(key, rows, rows)
        flat: list[Any] = []
        for row in found:
            if not isinstance(row, list) or len(row) != columns:
                raise FormatError(f"{self.name}.{key} must have rows of {columns} numbers")
            flat += row
        if may_miss:
            flat = [math.nan if each is None else each for each in flat]
        return self._numbers(key, flat, (rows, columns))

    def bits(self, key: str, text: Any, n: int) -> NDArray[np.bool_]:
        """A text of n characters, each 0 or 1."""
        if not isinstance(text, str) or len(text) != n or set(text) - {"0", "1"}:
            raise FormatError(f"{self.name}.{key} must be {n} characters 0 or 1, got {_shown(text)}")
        return np.array([each == "1" for each in text], bool)

    def _numbers(self, key: str, found: list[Any], shape: tuple[int, ...]) -> NDArray[np.float64]:
        for each in found:
            if type(each) is not float and not (type(each) is int and abs(each) < 2**53):
                raise FormatError(f"{self.name}.{key} must hold numbers, got {_shown(each)}")
        return np.array(found, np.float64).reshape(shape)

    def _whole(self, key: str, found: list[Any]) -> NDArray[np.int32]:
        for each in found:
            if type(each) is not int or not 0 <= each < 2**31:
                raise FormatError(
                    f"{self.name}.{key} must hold whole numbers from 0 to 2^31 - 1, got {_shown(each)}"
                )
        return np.array(found, np.int32)


def _model(model: _Section) -> SpeciesModel:
    classes = model.texts("classes", 2, MAX_CLASSES)
    features = model.texts("features", 1, MAX_FEATURES)
    span = model.section("span", ("centre", "spread"))
    rejection = model.section("rejection", REJECTION_FIELDS)
    provenance = model.content["provenance"]
    if not isinstance(provenance, dict):
        raise FormatError(f"model.provenance must be an object, got {type(provenance).__name__}")
    return SpeciesModel(
        name=model.text("name"),
        version=model.text("version"),
        classes=classes,
        features=features,
        stumps=_stumps(model.section("stumps", STUMP_FIELDS), len(classes), len(features)),
        temperature=model.number("temperature"),
        span=FeatureRange(
            span.matrix("centre", len(classes), len(features), may_miss=True),
            span.matrix("spread", len(classes), len(features)),
        ),
        rejection=Rejection(
            **{name: rejection.number(name) for name in REJECTION_FIELDS[:-1]},
            n_measured=rejection.whole("n_measured"),
        ),
        provenance=provenance,
    )


def _stumps(rows: _Section, n_classes: int, n_features: int) -> Stumps:
    n_outputs = 1 if n_classes == 2 else n_classes
    m = len(rows.items("feature", 0, MAX_STUMPS))
    texts = rows.items("shared", m, m)
    shared = np.array([rows.bits("shared", each, n_outputs) for each in texts], bool).reshape(m, n_outputs)
    constant = np.zeros((m, n_outputs))
    for j, row in enumerate(rows.items("constant", m, m)):
        n_others = n_outputs - int(shared[j].sum())
        if not isinstance(row, list) or len(row) != n_others:
            raise FormatError(f"{rows.name}.constant[{j}] must hold {n_others} numbers, one per other class")
        constant[j, ~shared[j]] = rows._numbers("constant", row, (n_others,))
    return Stumps(
        n_features=n_features,
        intercept=rows.vector("intercept", n_outputs),
        feature=rows.wholes("feature", m),
        threshold=rows.vector("threshold", m),
        missing_above=rows.bits("missing_above", rows.content["missing_above"], m),
        above=rows.vector("above", m),
        below=rows.vector("below", m),
        shared=shared,
        constant=constant,
        above_share=rows.vector("above_share", m),
        gain=rows.vector("gain", m),
    )
