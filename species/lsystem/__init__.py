"""L-systems: a grammar is read, derived to a word, and drawn by a turtle as a tree and its leaves.

docs/lsystem.md has the language.
"""

from species.lsystem.derivation import DerivationLimits, derive_word
from species.lsystem.parsing import parse_grammar
from species.lsystem.syntax import Grammar
from species.lsystem.turtle import Drawing, LeafPlacements, draw_word
from species.lsystem.word import TurtleSettings, Word

__all__ = [
    "DerivationLimits",
    "Drawing",
    "Grammar",
    "LeafPlacements",
    "TurtleSettings",
    "Word",
    "derive_word",
    "draw_word",
    "parse_grammar",
]
