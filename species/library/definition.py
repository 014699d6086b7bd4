"""What a person writes down of a species: one small TOML file, read and checked.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, sections 3.3.1 (parameters of a species), 3.4 (branchlets of a species library).
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from species._art_shape import SEASONS, LeafColors, LeafShape
from species.barkart import BarkShape
from species.parameters import Preset, preset_of
from treegraph import Allometry
from treegraph.errors import FormatError, InputError

if TYPE_CHECKING:
    from species.lsystem import Grammar

__all__ = ["BladeRules", "BranchletRules", "Definition", "Phenology", "parse_definition", "read_definition"]

MOST_FILE_BYTES = 100_000
LONGEST_MESSAGE = 400  # characters; a value that is not what it should be may be long
LARGEST_NUMBER = 1e15
MOST_BRANCHLETS = 60
MOST_NAMES = 40
LONGEST_NAME = 80
DAYS = 365
TABLES = ("allometry", "branchlets", "leaf", "leaf_colors", "bark", "blade", "phenology", "growth")
NEEDED = ("name", "latin", "leaf_area_density", "allometry", "branchlets", "leaf", "bark")
ALLOMETRY = ("beta", "gamma", "f_s")
KEYS = (*NEEDED, "also", "what", *TABLES)


@dataclass(frozen=True)
class Phenology:
    """When a tree has which leaves, as days of the year on the northern half of the earth, 1 to 365.

    Attributes
    ----------
    leaf_out, summer, autumn, leaf_fall : int
        First day with young leaves, with grown leaves, with autumn colours, and without leaves; ascending.
        An evergreen has no leaf fall: its leaves of autumn and winter follow from the colours alone.
    """

    leaf_out: int = 105
    summer: int = 140
    autumn: int = 275
    leaf_fall: int = 315

    def __post_init__(self) -> None:
        days = (self.leaf_out, self.summer, self.autumn, self.leaf_fall)
        whole = all(isinstance(day, int) and not isinstance(day, bool) for day in days)
        if not whole or not 1 <= days[0] < days[1] < days[2] < days[3] <= DAYS:
            raise InputError(
                f"leaf_out, summer, autumn and leaf_fall must be ascending days from 1 to {DAYS}, got {days}"
            )

    def season(self, day: int) -> str:
        """The season of a day of the year, 1 to 366: "spring", "summer", "autumn" or "winter".

        Raises
        ------
        InputError
            If it is no such day.
        """
        if isinstance(day, bool) or not hasattr(day, "__index__") or not 1 <= day <= DAYS + 1:
            raise InputError(f"day must be a whole number from 1 to {DAYS + 1}, got {day!r}")
        edges = (self.leaf_out, self.summer, self.autumn, self.leaf_fall)
        return ("winter", "spring", "summer", "autumn", "winter")[sum(day >= edge for edge in edges)]


@dataclass(frozen=True)
class BranchletRules:
    """How branchlets are derived.

    Attributes
    ----------
    grammar : str
        An L-system (docs/lsystem.md) with ``param size`` and ``param slope``. Its axiom turns the twig to
        its slope, ``&(90 - slope)``; it is drawn as it hangs on the tree, z up.
    count : int
        1 to 60 branchlets.
    size : (float, float)
        Range of the parameter ``size``, which is spread evenly over the branchlets, > 0.
    slope_deg : (float, float)
        Range of the parameter ``slope``: degrees above the horizontal at which the twig sets off, -90 to 90.
    """

    grammar: str
    count: int = 24
    size: tuple[float, float] = (0.35, 1.0)
    slope_deg: tuple[float, float] = (-20.0, 70.0)

    def __post_init__(self) -> None:
        if not isinstance(self.grammar, str) or not self.grammar.strip():
            raise InputError("grammar must be the text of an L-system (docs/lsystem.md)")
        if isinstance(self.count, bool) or not isinstance(self.count, int):
            raise InputError(f"count must be a whole number of branchlets, got {self.count!r}")
        if not 1 <= self.count <= MOST_BRANCHLETS:
            raise InputError(f"count must be from 1 to {MOST_BRANCHLETS} branchlets, got {self.count}")
        for name, low, high in (("size", 1e-3, 100.0), ("slope_deg", -90.0, 90.0)):
            object.__setattr__(self, name, _range(name, getattr(self, name), low, high))

    def parse(self) -> Grammar:
        """The grammar.

        Raises
        ------
        GrammarError
            With line and column of what is wrong.
        """
        from species.lsystem import parse_grammar

        return parse_grammar(self.grammar)


@dataclass(frozen=True)
class BladeRules:
    """Into how many quads a leaf is cut, `across` (1 or 2) and `along` (1 to 8), to be folded and bent."""

    across: int = 1
    along: int = 1

    def __post_init__(self) -> None:
        for name, most in (("across", 2), ("along", 8)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
                raise InputError(f"{name} must be a whole number from 1 to {most}, got {value!r}")


@dataclass(frozen=True)
class Definition:
    """A species as its file says it.

    Attributes
    ----------
    name, latin : str
        The name under which it is found, and its scientific name.
    also : tuple of str
        Other names under which it is found.
    what : str
        One line.
    leaf_area_density : float
        One side of all leaves in a cubic metre of leaf cluster, m2/m3, above 0 to 50.
    allometry : Allometry
        beta, gamma and f_s (thesis table 3.1).
    branchlets : BranchletRules
    leaf : LeafShape
    colors : LeafColors
    bark : BarkShape
    blade : BladeRules
    phenology : Phenology
    growth : Preset or None
        Parameters of the growth model and the age up to which it is grown if nothing else is said.
    text : str
        The file.
    """

    name: str
    latin: str
    leaf_area_density: float
    allometry: Allometry
    branchlets: BranchletRules
    leaf: LeafShape
    colors: LeafColors
    bark: BarkShape
    blade: BladeRules = BladeRules()
    phenology: Phenology = Phenology()
    growth: Preset | None = None
    also: tuple[str, ...] = ()
    what: str = ""
    text: str = ""

    def __repr__(self) -> str:
        return f"<Definition {self.name} ({self.latin})>"

    @property
    def names(self) -> tuple[str, ...]:
        """Every name under which it is found."""
        return (self.name, self.latin, *self.also)

    def is_bare(self, season: str) -> bool:
        """Whether it stands without leaves in a season.

        Raises
        ------
        InputError
            If there is no such season.
        """
        if season not in SEASONS:
            raise InputError(f"season must be one of {', '.join(SEASONS)}, got {season!r}")
        return self.colors.of_season(season) is None


def read_definition(path: str | os.PathLike[str]) -> Definition:
    """Read a species from its TOML file.

    Raises
    ------
    InputError
        If the file cannot be read, or something in it is missing, unknown or out of its range.
    FormatError
        If it is not TOML. Every message begins with the path and names the table.
    """
    name = os.fspath(path)
    if os.path.exists(path) and not os.path.isfile(path):  # nor a pipe, which might never end
        raise InputError(f"{name}: this is not a file; name a species' TOML file.")
    try:
        with open(path, "rb") as file:
            data = file.read(MOST_FILE_BYTES + 1)
    except FileNotFoundError:
        raise InputError(f"{name}: there is no such file.") from None
    except OSError as error:
        raise InputError(f"{name}: the file cannot be read ({error.strerror}).") from None
    if len(data) > MOST_FILE_BYTES:
        raise FormatError(f"{name}: larger than {MOST_FILE_BYTES} bytes; a species is a short TOML file")
    try:
        text = data.decode("utf-8-sig")  # some editors put a mark before the text
    except UnicodeDecodeError as error:
        raise FormatError(f"{name}: not a TOML file of a species ({error})") from None
    try:
        return parse_definition(text.replace("\r\n", "\n"))
    except (InputError, FormatError) as error:
        raise type(error)(f"{name}: {error}") from None


def parse_definition(text: str) -> Definition:
    """Read a species from the text of its file; see :func:`read_definition`."""
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise FormatError(_short(f"not a TOML file of a species ({error})")) from None
    try:
        return _parse(table, text)
    except InputError as error:
        raise InputError(_short(str(error))) from None


def _parse(table: Mapping[str, Any], text: str) -> Definition:
    _check_keys("", table, KEYS)
    missing = [key for key in NEEDED if key not in table]
    if missing:
        raise InputError(f"{', '.join(missing)}: missing; a species needs {', '.join(NEEDED)}")
    density = table["leaf_area_density"]
    if isinstance(density, bool) or not isinstance(density, int | float) or not 0.0 < density <= 50.0:
        raise InputError(f"leaf_area_density must be above 0 and at most 50 m2/m3, got {density!r}")
    what = table.get("what", "")
    if not isinstance(what, str) or len(what.splitlines()) > 1:
        raise InputError(f"what must be one line of text, got {what!r}")
    also = table.get("also", [])
    if not isinstance(also, list) or len(also) > MOST_NAMES:
        raise InputError(f"also must be a list of at most {MOST_NAMES} names, got {also!r}")
    return Definition(
        name=_name("name", table["name"]),
        latin=_name("latin", table["latin"]),
        leaf_area_density=float(density),
        allometry=_allometry(table),
        branchlets=_made("branchlets", table, BranchletRules),
        leaf=_made("leaf", table, LeafShape),
        colors=_made("leaf_colors", table, LeafColors),
        bark=_made("bark", table, BarkShape),
        blade=_made("blade", table, BladeRules),
        phenology=_made("phenology", table, Phenology),
        growth=_growth(table),
        also=tuple(_name("also", name) for name in also),
        what=what.strip(),
        text=text,
    )


def _short(message: str) -> str:
    """A message that does not repeat a whole file."""
    return message if len(message) <= LONGEST_MESSAGE else f"{message[: LONGEST_MESSAGE - 4]} ..."


def _made(name: str, table: Mapping[str, Any], kind: Callable[..., Any], known: Any = None) -> Any:
    """An object of the table of this name; what is wrong with it is said with the table's name."""
    values = table.get(name, {})
    if not isinstance(values, dict):
        raise InputError(f"[{name}] must be a table, got {values!r}")
    fields: Mapping[str, Any] = kind.__dataclass_fields__  # type: ignore[attr-defined]
    known = known or tuple(fields)
    _check_keys(f"[{name}] ", values, known)
    missing = [key for key in known if key not in values and _is_needed(fields[key])]
    if missing:
        raise InputError(f"[{name}] {', '.join(missing)}: missing")
    for key, value in values.items():
        if isinstance(value, int) and abs(value) > LARGEST_NUMBER:
            raise InputError(f"[{name}] {key} is too large a number, got {value!r}")
    try:
        return kind(**values)
    except InputError as error:
        raise InputError(f"[{name}] {error}") from None


def _allometry(table: Mapping[str, Any]) -> Allometry:
    values = table["allometry"]
    for key, value in values.items() if isinstance(values, dict) else ():
        if key in ALLOMETRY and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise InputError(f"[allometry] {key} must be a number, got {value!r}")
    made: Allometry = _made("allometry", table, Allometry, ALLOMETRY)
    return made


def _is_needed(field: Any) -> bool:
    from dataclasses import MISSING

    return field.default is MISSING and field.default_factory is MISSING


def _growth(table: Mapping[str, Any]) -> Preset | None:
    if "growth" not in table:
        return None
    values = table["growth"]
    if not isinstance(values, dict):
        raise InputError(f"[growth] must be a table of growth parameters, got {values!r}")
    values = {key: value for key, value in values.items() if key != "name"}
    try:
        return preset_of(str(table["name"]), values)
    except InputError as error:
        raise InputError(f"[growth] {error}") from None


def _check_keys(where: str, table: Mapping[str, Any], known: Any) -> None:
    for key in table:
        if key not in known:
            near = get_close_matches(key[:LONGEST_NAME], known, 1, 0.5)
            hint = f"; did you mean {near[0]!r}?" if near else f"; there are {', '.join(known)}"
            raise InputError(f"{where}there is no entry {key!r}{hint}")


def _name(key: str, value: Any) -> str:
    good = isinstance(value, str) and value.isprintable() and len(value.strip()) <= LONGEST_NAME
    if not good or not any(character.isalnum() for character in value):
        raise InputError(
            f"{key} must be a name of 1 to {LONGEST_NAME} printable characters with a letter, got {value!r}"
        )
    return str(value).strip()


def _range(name: str, value: Any, low: float, high: float) -> tuple[float, float]:
    several = isinstance(value, list | tuple) and len(value) == 2
    right = several and all(isinstance(part, int | float) and not isinstance(part, bool) for part in value)
    if not right or not low <= value[0] <= value[1] <= high:
        raise InputError(f"{name} must be two ascending numbers from {low:g} to {high:g}, got {value!r}")
    return float(value[0]), float(value[1])
