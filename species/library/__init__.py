"""The species library: what is known of a species, its branchlets and patches, its pictures.

A species is one small TOML file that a person edits; what is derived of it is kept beside it or in a cache.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from species.library.branchlets import Branchlet, cut_branchlet, derive_branchlets
    from species.library.building import Species, build_species, open_species
    from species.library.catalog import Library, builtin_library, derive_beside, find_species
    from species.library.definition import (
        BladeRules,
        BranchletRules,
        Definition,
        Phenology,
        parse_definition,
        read_definition,
    )

_LAZY = {
    "BladeRules": "definition",
    "Branchlet": "branchlets",
    "BranchletRules": "definition",
    "Definition": "definition",
    "Library": "catalog",
    "Phenology": "definition",
    "Species": "building",
    "build_species": "building",
    "builtin_library": "catalog",
    "cut_branchlet": "branchlets",
    "derive_beside": "catalog",
    "derive_branchlets": "branchlets",
    "find_species": "catalog",
    "open_species": "building",
    "parse_definition": "definition",
    "read_definition": "definition",
}

__all__ = [
    "BladeRules",
    "Branchlet",
    "BranchletRules",
    "Definition",
    "Library",
    "Phenology",
    "Species",
    "build_species",
    "builtin_library",
    "cut_branchlet",
    "derive_beside",
    "derive_branchlets",
    "find_species",
    "open_species",
    "parse_definition",
    "read_definition",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"species.library.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'species.library' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
