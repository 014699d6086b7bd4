"""The parameters of the growth model: table 1 of Stava et al. 2014, with units and legal ranges.

Based on: O. Stava, S. Pirk, J. Kratt, B. Chen, R. Mech, O. Deussen, B. Benes, "Inverse Procedural Modeling
of Trees", Computer Graphics Forum 33(6), 2014, table 1 (names and meaning) and table 2 (values).
Departs from it in: the paper gives no ranges, those here hold all values of its table 2 and leave room;
variances are taken as printed, as variances in square degrees, not as standard deviations.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from importlib import resources
from typing import Any

from treegraph.errors import FormatError, InputError

__all__ = [
    "MAX_AGE",
    "GrowthParameters",
    "Preset",
    "check_age",
    "find_preset",
    "format_growth",
    "parameter_table",
    "presets",
    "read_growth",
]

MAX_AGE = 200
"""Most growth cycles of a tree."""

TIP_SHARE, TIP_SHARES = 0.01, (0.0005, 0.2)  # default and range, as in species.GrowthSettings

MAX_FILE_BYTES = 100_000
PRESET_FILE = "figure6.toml"


def _parameter(symbol: str, low: float, high: float, unit: str, what: str) -> Any:
    return field(metadata={"symbol": symbol, "low": low, "high": high, "unit": unit, "what": what})


@dataclass(frozen=True)
class GrowthParameters:
    """The 24 parameters of table 1, in the order of the paper.

    Attributes
    ----------
    apical_angle_variance_deg2 : float
        AAV, 0 to 3600 square degrees: variance of the angle between a shoot and the apical bud at its end.
    n_lateral_buds : int
        NLB, 0 to 8: lateral buds at each node of a growing shoot.
    branching_angle_mean_deg, branching_angle_variance_deg2 : float
        BAM, 0 to 180 degrees, and BAV, 0 to 3600 square degrees: angle between a lateral bud and its shoot.
    roll_angle_mean_deg, roll_angle_variance_deg2 : float
        RAM, -360 to 360 degrees, and RAV, 0 to 14400 square degrees: turn of the lateral buds around the
        shoot from one internode to the next.
    apical_bud_extinction, lateral_bud_extinction : float
        AB_D and LB_D, 0 to 1: probability that a bud dies in a growth cycle.
    apical_light_factor, lateral_light_factor : float
        LF_A and LF_L, 0 to 10: exponent of the light in the probability of flushing.
    dominance_base : float
        AD_BF, 0 to 100: auxin that a flushing bud makes.
    dominance_distance : float
        AD_DF, 0 to 1: share of it that is left after a metre of way towards the root.
    dominance_age : float
        AD_AF, 0.01 to 1: share of it that is left after a year of the tree's age.
    growth_rate : float
        GR, 0 to 12 internodes per shoot and cycle.
    internode_length : float
        IBL, 0.005 to 3 metres.
    internode_age : float
        IL_AF, 0.5 to 1: its factor per year of the tree's age.
    apical_control : float
        AC, 0.05 to 20: how much slower shoots grow per level of their branch; under 1, how much faster.
    apical_control_age : float
        AC_AF, 0.3 to 1.2: its factor per year.
    phototropism, gravitropism : float
        PT and GT, -2 to 2: weight, per internode, of the light's mean direction and of the upward one.
    pruning_factor : float
        PF, 0 to 10: how much light a branch needs to be kept.
    low_branch_height : float
        LB_PF, 0 to 60 metres: side branches that leave their bearer lower than this are removed.
    bending_strength : float
        GBS, 0 to 10: how much a load bends.
    bending_angle : float
        GBA, 0 to 1: factor of the largest bending angle per centimetre of a branch's thickness.

    Raises
    ------
    InputError
        If a value is out of its range, no number, or n_lateral_buds is not whole; the message has the
        parameter, its range and the value.

    Examples
    --------
    >>> find_preset("F6b").parameters.internode_length
    0.49
    >>> find_preset("F6b").parameters.replace(growth_rate=40)
    Traceback (most recent call last):
        ...
    treegraph.errors.InputError: growth_rate (GR) must be from 0 to 12 internodes per cycle, got 40.0
    """

    apical_angle_variance_deg2: float = _parameter(
        "AAV", 0, 3600, "square degrees", "spread of the apical bud's angle"
    )
    n_lateral_buds: int = _parameter("NLB", 0, 8, "buds per node", "lateral buds at each node of a shoot")
    branching_angle_mean_deg: float = _parameter(
        "BAM", 0, 180, "degrees", "angle between lateral bud and shoot"
    )
    branching_angle_variance_deg2: float = _parameter("BAV", 0, 3600, "square degrees", "spread of BAM")
    roll_angle_mean_deg: float = _parameter("RAM", -360, 360, "degrees", "turn of the buds from node to node")
    roll_angle_variance_deg2: float = _parameter("RAV", 0, 14400, "square degrees", "spread of RAM")
    apical_bud_extinction: float = _parameter("AB_D", 0, 1, "per cycle", "death rate of apical buds")
    lateral_bud_extinction: float = _parameter("LB_D", 0, 1, "per cycle", "death rate of lateral buds")
    apical_light_factor: float = _parameter("LF_A", 0, 10, "", "how much light apical buds need to flush")
    lateral_light_factor: float = _parameter("LF_L", 0, 10, "", "how much light lateral buds need to flush")
    dominance_base: float = _parameter("AD_BF", 0, 100, "", "auxin of a flushing bud")
    dominance_distance: float = _parameter("AD_DF", 0, 1, "per metre", "auxin left after a metre")
    dominance_age: float = _parameter("AD_AF", 0.01, 1, "per year", "factor of the auxin with age")
    growth_rate: float = _parameter("GR", 0, 12, "internodes per cycle", "internodes of a shoot")
    internode_length: float = _parameter("IBL", 0.005, 3, "metres", "length of an internode")
    internode_age: float = _parameter("IL_AF", 0.5, 1, "per year", "factor of IBL with age")
    apical_control: float = _parameter("AC", 0.05, 20, "per level", "growth of the leader over side branches")
    apical_control_age: float = _parameter("AC_AF", 0.3, 1.2, "per year", "factor of AC with age")
    phototropism: float = _parameter("PT", -2, 2, "per internode", "bending towards the light")
    gravitropism: float = _parameter("GT", -2, 2, "per internode", "bending upwards")
    pruning_factor: float = _parameter("PF", 0, 10, "", "shedding of shaded branches")
    low_branch_height: float = _parameter("LB_PF", 0, 60, "metres", "height without side branches")
    bending_strength: float = _parameter("GBS", 0, 10, "", "bending under load")
    bending_angle: float = _parameter("GBA", 0, 1, "per centimetre", "how thickness limits the bending")

    def __post_init__(self) -> None:
        for entry in fields(self):
            object.__setattr__(self, entry.name, _checked(entry, getattr(self, entry.name)))

    def replace(self, **changes: float) -> GrowthParameters:
        """The same with some of the parameters changed, by their names or their symbols.

        Raises
        ------
        InputError
            If a name is unknown or a value out of its range.
        """
        names = {entry.metadata["symbol"]: entry.name for entry in fields(self)}
        named: dict[str, Any] = {names.get(key, key): value for key, value in changes.items()}
        _check_names(named, list(names.values()))
        return replace(self, **named)

    def symbols(self) -> dict[str, float]:
        """The values by the paper's symbols: ``{"AAV": 0.0, "NLB": 2, ...}``."""
        return {entry.metadata["symbol"]: getattr(self, entry.name) for entry in fields(self)}

    @classmethod
    def from_symbols(cls, values: Mapping[str, float]) -> GrowthParameters:
        """Make them from all 24 values by the paper's symbols.

        Raises
        ------
        InputError
            If one is missing, unknown or out of its range.
        """
        names = {entry.metadata["symbol"]: entry.name for entry in fields(cls)}
        return cls(**{names[key]: value for key, value in _complete(values, names).items()})


@dataclass(frozen=True)
class Preset:
    """A kind of tree by name.

    Attributes
    ----------
    name : str
    parameters : GrowthParameters
    age : int
        Growth cycles after which it looks as it does in the paper, t of table 2.
    what : str
        One line on it.
    tip_share : float, default 0.01
        Radius of a tip as a share of the internode length, 0.0005 to 0.2: how thick all its wood is. None of
        the paper's parameters; :class:`species.GrowthSettings` has it too.
    """

    name: str
    parameters: GrowthParameters
    age: int
    what: str = ""
    tip_share: float = TIP_SHARE


def _checked(entry: Any, value: Any) -> float | int:
    """A parameter's value as float or int, if it is in its range."""
    low, high, unit = (entry.metadata[key] for key in ("low", "high", "unit"))
    name = f"{entry.name} ({entry.metadata['symbol']})"
    whole = entry.name == "n_lateral_buds"
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be a number, got {value!r}") from None
    except OverflowError:  # a whole number of more than 308 digits
        number = math.inf if value > 0 else -math.inf
    if isinstance(value, bool | str):
        raise InputError(f"{name} must be a number, got {value!r}")
    if whole and not number.is_integer():
        raise InputError(f"{name} must be a whole number from {low} to {high}, got {value!r}")
    if not low <= number <= high:
        raise InputError(f"{name} must be from {low} to {high}{' ' * bool(unit)}{unit}, got {number!r}")
    return int(number) if whole else number


def check_age(age: Any) -> int:
    """Return an age in growth cycles: a whole number from 0 to :data:`MAX_AGE`."""
    if isinstance(age, bool) or not isinstance(age, int) and not hasattr(age, "__index__"):
        raise InputError(f"age must be a whole number of growth cycles, got {age!r}")
    number = int(age.__index__())
    if not 0 <= number <= MAX_AGE:
        raise InputError(f"age must be from 0 to {MAX_AGE} growth cycles, got {number}")
    return number


def parameter_table() -> list[dict[str, Any]]:
    """Name, symbol, unit, range and meaning of each parameter, for tables and for search."""
    return [
        {"name": entry.name, **entry.metadata, "integer": entry.name == "n_lateral_buds"}
        for entry in fields(GrowthParameters)
    ]


def _check_names(values: Iterable[str], known: Iterable[str]) -> None:
    """Raise InputError about the first name that is not known, with the nearest that is."""
    from difflib import get_close_matches

    known = list(known)
    for key in values:
        if key not in known:
            near = get_close_matches(key, known, 1, 0.4)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise InputError(f"there is no growth parameter {key!r}{hint}")


def _complete(values: Mapping[str, Any], known: Mapping[str, Any]) -> Mapping[str, Any]:
    """The values, if every known name is there and no other."""
    _check_names(values, known)
    missing = [key for key in known if key not in values]
    if missing:
        raise InputError(
            f"{len(missing)} of {len(known)} growth parameters are missing: {', '.join(missing[:5])}"
            f"{' ...' * (len(missing) > 5)}"
        )
    return values


def preset_of(name: str, table: Any) -> Preset:
    """A preset from its table in a TOML file: ``age``, ``what``, and the parameters by name or by symbol."""
    if not isinstance(table, dict):
        raise InputError(f"[{name}] must be a table of growth parameters")
    values = dict(table)
    age, what = values.pop("age", None), values.pop("what", "")
    tip_share = _check_tip_share(values.pop("tip_share", TIP_SHARE))
    if age is None:
        raise InputError("age is missing: the number of growth cycles, as in `age = 20`")
    symbol = {entry.metadata["symbol"]: entry.name for entry in fields(GrowthParameters)}
    named = {symbol.get(key, key): value for key, value in values.items()}
    if len(named) < len(values):
        raise InputError("a growth parameter is given twice, by its name and by its symbol")
    names = {entry.name: entry for entry in fields(GrowthParameters)}
    return Preset(name, GrowthParameters(**_complete(named, names)), check_age(age), str(what), tip_share)


def _check_tip_share(value: Any) -> float:
    low, high = TIP_SHARES
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError(f"tip_share must be a number from {low} to {high}, got {value!r}")
    return float(value)


@cache
def presets() -> dict[str, Preset]:
    """The six trees of figure 6 (table 2) by name, ``"F6a"`` to ``"F6f"``.

    The values of F6e are those of the printed column moved down by one row from its second entry on; what
    is still missing or doubtful was chosen and is marked in ``species/figure6.toml``.
    """
    text = resources.files("species").joinpath(PRESET_FILE).read_text(encoding="utf-8")
    return {name: preset_of(name, table) for name, table in tomllib.loads(text).items()}


def find_preset(name: str) -> Preset:
    """The preset of this name, in whatever case.

    Raises
    ------
    InputError
        If there is none; the message has all names.
    """
    for known, preset in presets().items():
        if known.lower() == str(name).lower():
            return preset
    raise InputError(f"there is no preset {name!r}; there are {', '.join(presets())}")


def read_growth(path: str | os.PathLike[str]) -> Preset:
    """Read growth parameters from a TOML file.

    The file has the keys ``age`` and all 24 parameters, by name or by symbol, at its top or in a table
    ``[growth]``; ``name``, ``what`` and ``tip_share`` are optional. Anything outside ``[growth]``, if that is
    there, is left alone.

    Raises
    ------
    InputError
        If the file cannot be read, or a parameter is missing, unknown or out of its range.
    FormatError
        If it is not TOML. Both messages begin with the path.
    """
    name = os.fspath(path)
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
    except FileNotFoundError:
        raise InputError(f"{name}: there is no such file.") from None
    except OSError as error:
        raise InputError(f"{name}: the file cannot be read ({error.strerror}).") from None
    if len(data) > MAX_FILE_BYTES:
        raise FormatError(
            f"{name}: larger than {MAX_FILE_BYTES} bytes; growth parameters are a short TOML file"
        )
    try:
        document = tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # no TOML, no UTF-8, numbers of thousands of digits
        raise FormatError(f"{name}: not a TOML file of growth parameters ({error})") from None
    table = document.get("growth", document)
    try:
        values = dict(table) if isinstance(table, dict) else table
        label = values.pop("name", None) if isinstance(values, dict) else None
        return preset_of(str(label or os.path.splitext(os.path.basename(name))[0]), values)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def format_growth(preset: Preset) -> str:
    """The text of a TOML file that :func:`read_growth` reads back as the same preset."""
    lines = ["[growth]", f"name = {_quoted(preset.name)}", f"age = {preset.age}"]
    if preset.what:
        lines.append(f"what = {_quoted(preset.what)}")
    if preset.tip_share != TIP_SHARE:
        lines.append(f"tip_share = {preset.tip_share!r}  # radius of a tip as a share of IBL")
    entries = {entry.name: entry.metadata for entry in fields(GrowthParameters)}
    for name, value in asdict(preset.parameters).items():
        about = entries[name]
        lines.append(f"{name} = {value!r}  # {about['symbol']}: {about['what']}")
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    """A basic string of TOML: as JSON has it, but no pairs of surrogates, and DEL is escaped."""
    import json

    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
