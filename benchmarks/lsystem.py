"""L-systems: modules derived, and drawn, in a second."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks import report

REPEATS = 5
SEED = 0

TREE = """
const r1 = 0.9
const r2 = 0.7
axiom = A(1, 0.1)
A(l, w) -> !(w) F(l) [ &(45) B(l * r2, w * 0.707) ] /(137.5) A(l * r1, w * 0.707)
B(l, w) -> !(w) F(l) [ -(45) $ C(l * r2, w * 0.707) ] C(l * r1, w * 0.707)
C(l, w) -> !(w) F(l) [ +(45) $ B(l * r2, w * 0.707) ] B(l * r1, w * 0.707)
"""

#: name, text, iterations
GRAMMARS = (
    ("plain", "angle = 25.7\naxiom = F\nF -> F[+F]F[-F]F", 7),
    ("parametric", TREE, 15),
    ("conditions", "axiom = F(1)\nF(x) : x > 1e-4 -> F(x * 0.4) + F(x * 0.3) - F(x * 0.5)", 11),
    ("stochastic", "axiom = F\nF -> (1) F[+F]F[-F]F\nF -> (1) F[+F]F\nF -> (1) F[-F]F", 8),
    ("random numbers", "axiom = A(1)\nA(x) -> F(x)[+(normal(30, 5))A(x * uniform(0.6, 0.9))]A(x * 0.9)", 15),
    ("contexts", "ignore = + -\naxiom = BA\nB < A -> B[+A]B[-A]A\nA > B -> A", 10),
)


def measure(name: str, text: str, iterations: int) -> dict[str, Any]:
    """Least processor time of several runs; modules counted are those of all words, as all are written."""
    from species import derive_word, draw_word, parse_grammar

    grammar = parse_grammar(text)
    draw_word(derive_word(grammar, rng=np.random.default_rng(SEED), iterations=0))  # compiles
    written = sum(
        derive_word(grammar, rng=np.random.default_rng(SEED), iterations=k).n_modules
        for k in range(1, iterations + 1)
    )
    derive_s, draw_s = [], []
    for _ in range(REPEATS):
        start = process_time()
        word = derive_word(grammar, rng=np.random.default_rng(SEED), iterations=iterations)
        middle = process_time()
        drawing = draw_word(word)
        derive_s.append(middle - start)
        draw_s.append(process_time() - middle)
    return {
        "grammar": name,
        "modules": word.n_modules,
        "nodes": drawing.tree.n_nodes,
        "last_word_per_s": word.n_modules / min(derive_s),
        "all_words_per_s": written / min(derive_s),
        "drawn_per_s": word.n_modules / min(draw_s),
    }


def run(arguments: Namespace) -> None:
    """Print one row per grammar."""
    print("| grammar | modules | nodes | derived, modules/s | words before it too | drawn, modules/s |")
    print("|---|---|---|---|---|---|")
    rows = [measure(*one) for one in GRAMMARS]
    for row in rows:
        print(
            f"| {row['grammar']} | {row['modules']} | {row['nodes']} | {row['last_word_per_s']:.2g} "
            f"| {row['all_words_per_s']:.2g} | {row['drawn_per_s']:.2g} |",
            flush=True,
        )
    report.write_json(getattr(arguments, "json", None), "lsystem", rows)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.lsystem", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
