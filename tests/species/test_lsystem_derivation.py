"""Derived words: textbook systems word by word, contexts among brackets, chance, limits, every error.

The textbook is P. Prusinkiewicz, A. Lindenmayer, "The Algorithmic Beauty of Plants", 1990, chapter 1.
"""

import re
from time import perf_counter

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from species import DerivationError, DerivationLimits, TurtleSettings, Word, derive_word, parse_grammar
from treegraph import InputError


def words(text, n, **options):
    """The words of iterations 0 to n, without blanks."""
    grammar = parse_grammar(text)
    return [str(derive_word(grammar, iterations=k, **options)).replace(" ", "") for k in range(n + 1)]


def last(text, n, **options):
    return words(text, n, **options)[-1]


# ---------------------------------------------------------------- words without contexts


def test_algae():
    assert words("axiom = A\nA -> AB\nB -> A", 5) == ["A", "AB", "ABA", "ABAAB", "ABAABABA", "ABAABABAABAAB"]
    grammar = parse_grammar("axiom = A\nA -> AB\nB -> A")
    lengths = [derive_word(grammar, iterations=k).n_modules for k in range(25)]
    assert lengths[:2] == [1, 2]
    assert all(a + b == c for a, b, c in zip(lengths, lengths[1:], lengths[2:], strict=False))


def test_anabaena():
    """The filament of a bacterium: cells that divide, of two sizes and two polarities."""
    text = "module Ar Al Br Bl\naxiom = Ar\nAr -> Al Br\nAl -> Bl Ar\nBr -> Ar\nBl -> Al"
    assert words(text, 4) == ["Ar", "AlBr", "BlArAr", "AlAlBrAlBr", "BlArBlArArBlArAr"]


def test_koch_curves():
    island = "axiom = F-F-F-F\nF -> F-F+F+FF-F-F+F"
    once = "F-F+F+FF-F-F+F"
    assert last(island, 1) == "-".join([once] * 4)
    assert last(island, 3).count("F") == 4 * 8**3
    assert last("axiom = F\nF -> F+F--F+F", 2) == "+".join(["F+F--F+F"] * 2) + "--" + "+".join(
        ["F+F--F+F"] * 2
    )


def test_plants_with_brackets():
    assert last("axiom = F\nF -> F[+F]F[-F]F", 1) == "F[+F]F[-F]F"
    assert last("axiom = F\nF -> F[+F]F[-F]F", 5).count("F") == 5**5
    edge = "axiom = X\nX -> F[+X]F[-X]+X\nF -> FF"
    assert last(edge, 2) == "FF[+F[+X]F[-X]+X]FF[-F[+X]F[-X]+X]+F[+X]F[-X]+X"


def test_parametric_system():
    """The book's first parametric example; a module without a matching production stays."""
    text = """
        axiom = B(2) A(4, 4)
        A(x, y) : y <= 3 -> A(x * 2, x + y)
        A(x, y) : y > 3 -> B(x) A(x / y, 0)
        B(x) : x < 1 -> C
        B(x) : x >= 1 -> B(x - 1)
        module C
    """
    assert words(text, 4) == [
        "B(2)A(4,4)",
        "B(1)B(4)A(1,0)",
        "B(0)B(3)A(2,1)",
        "CB(2)A(4,3)",
        "CB(1)A(8,7)",
    ]


def test_row_of_trees():
    """Delays count down in a second parameter, which the turtle does not read."""
    text = """
        const p = 0.3
        const q = 1 - p
        const h = (p * q) ^ 0.5
        axiom = F(1, 0)
        F(x, t) : t = 0 -> F(x * p, 2) + F(x * h, 1) -- F(x * h, 1) + F(x * q, 0)
        F(x, t) : t > 0 -> F(x, t - 1)
    """
    grammar = parse_grammar(text)
    h = np.sqrt(0.3 * 0.7)
    word = derive_word(grammar, iterations=2)
    modules = re.findall(r"[^\s(]+?(?:\(.*?\))?", str(word).replace(" ", ""))
    assert "".join(m[0] for m in modules) == "F+F--F+F+F--F+F"
    npt.assert_allclose(
        word.number.reshape(-1, 2),
        [[0.3, 1], [h, 0], [h, 0], [0.21, 2], [0.7 * h, 1], [0.7 * h, 1], [0.49, 0]],
        rtol=1e-15,
    )


def test_kinds_differ_by_the_number_of_parameters():
    assert last("axiom = F F(1)\nF -> FF\nF(x) -> F(x + 1)", 1) == "FFF(2)"


def test_modules_may_have_many_parameters():
    text = "axiom = A(1,2,3,4,5,6,7,8)\nA(a,b,c,d,e,f,g,h) -> F(h,g,f) F(a) F(a+b,c) A(b,c,d,e,f,g,h,a)"
    assert last(text, 1) == "F(8,7,6)F(1)F(3,3)A(2,3,4,5,6,7,8,1)"


def test_all_functions_take_parameters():
    """Computed for each module, not once."""
    calls = ["atan2(x, y)", "max(x, y, 3)", "min(x, y)", "if(x > y, x, y)", "-x", "not y", "x > 1 or y / 0"]
    text = f"axiom = A(4, 0)\nA(x, y) -> {' '.join(f'F({call})' for call in calls)}"
    assert last(text, 1) == "F(90)F(4)F(0)F(4)F(-4)F(1)F(1)"


def test_first_production_that_matches_is_taken():
    text = "axiom = A(1) A(3)\nA(x) : x > 2 -> F\nA(x) -> f\nA(x) : x < 2 -> L"
    assert last(text, 1) == "fF"


def test_empty_successor_and_empty_axiom():
    assert last("axiom = ABA\nA ->\nB -> B", 1) == "B"
    assert last("axiom =\nA -> A", 3) == ""


# ---------------------------------------------------------------- contexts


def test_signal():
    text = "axiom = baaaaaaaa\nb < a -> b\nb -> a"
    assert words(text, 3) == ["baaaaaaaa", "abaaaaaaa", "aabaaaaaa", "aaabaaaaa"]


ACROPETAL = "module Fa Fb\nignore = + -\naxiom = Fb[+Fa]Fa[-Fa]Fa[+Fa]Fa\nFb < Fa -> Fb"
BASIPETAL = "module Fa Fb\nignore = + -\naxiom = Fa[+Fa]Fa[-Fa]Fa[+Fa]Fb\nFa > Fb -> Fb"


def test_signal_runs_up_into_the_branches():
    assert words(ACROPETAL, 3)[1:] == [
        "Fb[+Fb]Fb[-Fa]Fa[+Fa]Fa",
        "Fb[+Fb]Fb[-Fb]Fb[+Fa]Fa",
        "Fb[+Fb]Fb[-Fb]Fb[+Fb]Fb",
    ]


def test_signal_runs_down_along_the_axis_only():
    assert words(BASIPETAL, 3)[1:] == [
        "Fa[+Fa]Fa[-Fa]Fb[+Fa]Fb",
        "Fa[+Fa]Fb[-Fa]Fb[+Fa]Fb",
        "Fb[+Fa]Fb[-Fa]Fb[+Fa]Fb",
    ]


BOOK = "ABC[DE][SG[HI[JK]L]MNO]"


@pytest.mark.parametrize(
    "context, matches",
    [
        ("BC < S > G[H]M", True),  # the book's example: skips [DE] to the left, I[JK]L to the right
        ("ABC < S", True),
        ("C < S", True),
        ("E < S", False),
        ("AC < S", False),
        ("S > GM", True),
        ("S > G[HI]M", True),
        ("S > G[HI[J]]M", True),
        ("S > G[HI[J]L]MNO", True),
        ("S > G[HIL]M", True),
        ("S > G[HK]M", False),
        ("S > G[M]", False),
        ("S > GH", False),
        ("S > GMNOA", False),
        ("S > G[H][H]M", False),
        ("S > [G]", False),
    ],
)
def test_contexts_among_brackets(context, matches):
    text = f"module {' '.join('ABCDEGHIJKLMNO'.replace('L', ''))}\naxiom = {BOOK}\n{context} -> F"
    assert last(text, 1) == (BOOK.replace("S", "F") if matches else BOOK)


@pytest.mark.parametrize(
    "axiom, context, matches",
    [
        ("A[B][C]D", "A > [C]D", True),  # any of the branches that begin there
        ("A[B][C]D", "A > [B][C]D", True),
        ("A[B][C]D", "A > [C][B]D", False),
        ("A[B][C]D", "A > [[B]]D", False),
        ("A[[B]C]D", "A > [[B]C]D", True),
        ("A[[E][B]C]D", "A > [[B]C]D", True),
        ("A+[-B]D", "A > [B]D", True),  # + and - are not seen
        ("D[+A]", "D < A", True),
        ("D+A", "D < A", True),
        ("D[B]A", "D < A", True),
        ("D[A]B", "A > B", False),
        ("A", "B < A", False),
        ("A", "A > B", False),
        ("A[]", "A > [B]", False),
        ("A[B]", "A > [B]", True),
    ],
)
def test_branches_and_ignored_modules(axiom, context, matches):
    text = f"module A B C D E\nignore = + -\naxiom = {axiom}\n{context} -> F"
    wanted = axiom.replace("A", "F") if matches else axiom
    assert last(text, 1) == wanted


def test_parameters_of_contexts_are_known():
    rule = "A(a) B(b) < C(c) > D(d) : a < d -> C(a + 10 * b + 100 * c + 1000 * d)"
    text = f"axiom = A(1)B(2)[F(9)]C(3)D(4)\n{rule}"
    assert last("module A(x) D(x)\n" + text, 1) == "A(1)B(2)[F(9)]C(4321)D(4)"


def test_all_modules_are_replaced_at_once():
    """A context is that of the word before, whatever its neighbours become."""
    assert last("axiom = ABA\nA < B > A -> A\nA -> B", 1) == "BAB"


@given(st.lists(st.sampled_from("AB+[("), max_size=30), st.sampled_from(["A < B", "AA < B", "B < B"]))
@settings(deadline=None)
def test_left_contexts_match_the_slow_reference(pieces, context):
    """The reference walks a tree of parents."""
    text, depth = "", 0
    for piece in pieces:
        if piece == "(":
            piece = "]" if depth else ""
        depth += {"[": 1, "]": -1}.get(piece, 0)
        text += piece
    text += "]" * depth
    wanted, stack, path = "", [], ""
    for c in text:
        if c == "[":
            stack.append(path)
        elif c == "]":
            path = stack.pop()
        is_found = c == "B" and path.endswith(context.split()[0])
        wanted += "F" if is_found else c
        path += c if c in "AB" else ""
    assert last(f"module A B\nignore = +\naxiom = {text}\n{context} -> F", 1) == wanted


# ---------------------------------------------------------------- chance


def test_stochastic_productions_come_as_often_as_they_should():
    grammar = parse_grammar(f"axiom = {'A' * 6000}\nA -> (1) F\nA -> (2) f\nA -> (3) L")
    word = str(derive_word(grammar, rng=np.random.default_rng(1), iterations=1))
    for letter, share in (("F", 1 / 6), ("f", 1 / 3), ("L", 1 / 2)):
        spread = np.sqrt(6000 * share * (1 - share))
        assert abs(word.count(letter) - 6000 * share) < 4 * spread


def test_weights_may_depend_on_parameters():
    text = f"axiom = {'A(0)' * 50}{'A(1)' * 50}\nA(x) -> (x) F\nA(x) -> (1 - x) f"
    assert last(text, 1, rng=np.random.default_rng(0)) == "f" * 50 + "F" * 50


def test_weighted_productions_of_another_predecessor_are_no_rivals():
    """Only productions with the same modules in predecessor and context share a draw."""
    text = f"axiom = B{'A' * 200}\nB < A -> (1) F\nA -> (1) f\nA -> (1) L\nB -> B"
    word = last(text, 1, rng=np.random.default_rng(0))
    assert word[1] == "F"
    assert set(word[2:]) == {"f", "L"}


def test_of_rivals_only_those_that_match_take_part():
    text = f"axiom = {'A(1)' * 100}\nA(x) : x > 2 -> (100) F\nA(x) -> (1) f\nA(x) -> (0) L"
    assert last(text, 1, rng=np.random.default_rng(0)) == "f" * 100


def test_without_a_weight_above_zero_the_next_production_is_tried():
    rng = np.random.default_rng(0)
    assert last("axiom = A\nA -> (0) F\nA -> f", 1, rng=rng) == "f"
    assert last("axiom = A\nA -> (0) F", 1, rng=rng) == "A"


def test_same_seed_same_bytes():
    grammar = parse_grammar(
        "const a = uniform(1, 2)\naxiom = A(a)\n"
        "A(x) -> (1) F(x)[+(normal(30, 5))A(x * uniform(0.5, 1))]A(x)\nA(x) -> (2) F(x) A(x / 2)"
    )
    one, two, other = (
        derive_word(grammar, rng=np.random.default_rng(seed), iterations=8) for seed in (7, 7, 8)
    )
    assert one.code.tobytes() == two.code.tobytes()
    assert one.number.tobytes() == two.number.tobytes()
    assert str(one) != str(other)


def test_a_grammar_without_chance_leaves_the_generator_alone():
    rng = np.random.default_rng(0)
    derive_word(parse_grammar("axiom = A\nA -> AB\nB -> A"), rng=rng, iterations=5)
    assert rng.random() == np.random.default_rng(0).random()


# ---------------------------------------------------------------- parameters, settings, words


def test_parameters_replace_param_and_what_follows_from_it():
    text = "param a = 2\nconst b = a * 10\niterations = a\naxiom = F(a, b)\nF(x, y) -> F(x + 1, y)"
    grammar = parse_grammar(text)
    assert str(derive_word(grammar)) == "F(4, 20)"
    assert str(derive_word(grammar, parameters={"a": 3})) == "F(6, 30)"
    assert str(derive_word(grammar, parameters={"a": np.float32(1)})) == "F(2, 10)"


def test_settings_come_along():
    text = (
        "param s = 2\nangle = 30\nstep = s\nwidth = 1/s\ntaper = 0.9\nleaf = 0.3\ntropism = 1, s, 3\n"
        "axiom =\niterations = 0"
    )
    wanted = TurtleSettings(30, 2, 0.5, 0.9, 0.3, (1, 2, 3))
    assert derive_word(parse_grammar(text)).settings == wanted
    assert derive_word(parse_grammar("axiom =\niterations = 0")).settings == TurtleSettings()


def test_word_is_flat_arrays():
    word = derive_word(parse_grammar("axiom = F(1, 2)[+F]L(3)\niterations = 0"))
    assert [word.kinds[c] for c in word.code] == [("F", 2), ("[", 0), ("+", 0), ("F", 0), ("]", 0), ("L", 1)]
    assert word.number.tolist() == [1, 2, 3]
    assert word.start.tolist() == [0, 2, 2, 2, 2, 2, 3]
    assert (word.code.dtype, word.number.dtype, word.start.dtype) == (np.int32, np.float64, np.int64)
    assert (repr(word), word.n_modules) == ("<Word 6 modules>", 6)
    assert not word.code.flags.writeable
    assert not word.number.flags.writeable


def test_text_of_a_word_is_read_as_the_same_word():
    text = "module Bud(x)\naxiom = Bud(1) F(0.1)\nBud(x) -> F(x / 3)[-Bud(x / 7)] +(-1e-7) Bud(x * 1e9)"
    word = derive_word(parse_grammar(text), iterations=5)
    again = derive_word(parse_grammar(f"module Bud(x)\naxiom = {word}\niterations = 0"))
    assert str(again) == str(word)
    assert again.number.tobytes() == word.number.tobytes()


# ---------------------------------------------------------------- limits


def test_too_many_modules():
    grammar = parse_grammar("axiom = F\nF -> FF")
    limits = DerivationLimits(modules=1000)
    assert derive_word(grammar, iterations=9, limits=limits).n_modules == 512
    with pytest.raises(
        DerivationError,
        match=r"^the word has more than 1000 modules in iteration 10 of 500; ask for fewer iterations, or "
        r"for more modules with DerivationLimits\(modules=\.\.\.\)$",
    ):
        derive_word(grammar, iterations=500, limits=limits)
    with pytest.raises(DerivationError, match="more than 3 modules in iteration 0 of 0"):
        derive_word(parse_grammar("axiom = FFFF"), iterations=0, limits=DerivationLimits(modules=3))


def test_a_long_successor_cannot_run_past_the_limit():
    """The length is looked at after so few modules that memory stays bounded."""
    grammar = parse_grammar(f"axiom = {'A' * 5000}\nA -> {'F' * 50_000}")
    start = perf_counter()
    with pytest.raises(DerivationError, match="more than 1000000 modules in iteration 1 of 1"):
        derive_word(grammar, iterations=1)
    assert perf_counter() - start < 2.0


@pytest.mark.parametrize(
    "text, iterations",
    [
        ("axiom = F\nF -> FF", 40),
        ("axiom = A(0)\nA(x) -> A(x + 1) A(x + 2)", 40),
        (f"axiom = {'F' * 20_000}\nF -> f\nf -> F", 10_000),
        (f"module J\nignore = I\naxiom = {'I' * 20_000}{'[F]' * 20_000}\nI > J -> I\nI -> I\nJ -> J", 10_000),
        (f"axiom = {'A' * 20_000}\n" + "A : 1 < 0 -> F\n" * 4_000, 1),
        (f"module J\nignore = I\naxiom = {'I' * 20_000}{'[F]' * 20_000}J\nI > [J] -> I\nI -> I", 10_000),
    ],
    ids=["doubling", "parameters", "iterations", "branches", "productions", "contexts"],
)
def test_time_is_bounded(text, iterations):
    start = perf_counter()
    with pytest.raises(
        DerivationError, match=r"^deriving takes longer than 0\.3 s, in iteration \d+ of \d+; ask for fewer"
    ):
        derive_word(
            parse_grammar(text), iterations=iterations, limits=DerivationLimits(50_000_000, seconds=0.3)
        )
    assert perf_counter() - start < 3.0


def test_iterations_are_bounded():
    grammar = parse_grammar("axiom = F\niterations = 1e300")
    with pytest.raises(
        DerivationError, match=r"^at most 10000 iterations, got 1e\+300; ask for fewer, or for"
    ):
        derive_word(grammar)
    with pytest.raises(DerivationError, match="at most 5 iterations, got 6"):
        derive_word(grammar, iterations=6, limits=DerivationLimits(iterations=5))


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    "text, message",
    [
        ("axiom = F(1 / 0)", "line 1, column 13: 1 / 0 divides by zero"),
        ("axiom = F(1 % 0)", "line 1, column 13: 1 % 0 divides by zero"),
        ("axiom = F(0 ^ -1)", r"line 1, column 13: 0 \^ -1 divides by zero"),
        ("axiom = F((-8) ^ 0.5)", r"line 1, column 16: -8 \^ 0.5 is no real number"),
        ("axiom = F(1e200 * 1e200)", r"line 1, column 17: 1e\+200 \* 1e\+200 is too large; numbers go up to"),
        ("axiom = F(10 ^ 999)", r"line 1, column 14: 10 \^ 999 is too large"),
        ("axiom = F(1e308 + 1e308)", r"line 1, column 17: 1e\+308 \+ 1e\+308 is too large"),
        ("axiom = F(exp(1000))", r"line 1, column 11: exp\(1000\) is too large"),
        ("axiom = F(log(0))", r"line 1, column 11: log\(0\) is no real number"),
        ("axiom = F(sqrt(-1))", r"line 1, column 11: sqrt\(-1\) is no real number"),
        ("axiom = F(asin(2))", r"line 1, column 11: asin\(2\) is no real number"),
        ("axiom = F(tan(270))", r"line 1, column 11: tan\(270\) is no real number"),
        ("axiom = F(normal(0, -1))", "line 1, column 11: the spread of normal must be >= 0, got -1"),
        (
            "axiom = F(uniform(-1e308, 1e308))",
            r"line 1, column 11: uniform\(-1e\+308, 1e\+308\) is too large",
        ),
        ("axiom = A(1)\nA(x) -> A(x * 1e99)", r"line 2, column 13: 1e\+297 \* 1e\+99 is too large"),
        ("axiom = A(1)\nA(x) : 1 / (x - 1) > 0 -> F", "line 2, column 10: 1 / 0 divides by zero"),
        ("axiom = A\nA -> (1) F\nA -> (-1) f", "line 3, column 1: a weight must be >= 0, got -1"),
        (
            "axiom = A\nA -> (1e308) F\nA -> (1e308) f",
            "line 2, column 1: the weights are too large to be added",
        ),
        ("axiom = F\nwidth = -1", "width must be >= 0 and finite, got -1.0"),
        ("axiom = F\ntropism = 0, 0, 0", "tropism must be a direction of three numbers, got"),
    ],
)
def test_numbers_stay_in_range(text, message):
    with pytest.raises(DerivationError, match=f"^{message}"):
        derive_word(parse_grammar(text), rng=np.random.default_rng(0), iterations=5)


def test_infinity_cannot_hide():
    """Not even where the result would be finite again."""
    with pytest.raises(DerivationError, match="is too large"):
        derive_word(parse_grammar("axiom = A(1e200)\nA(x) -> F(1 / (x * x))"), iterations=1)


@pytest.mark.parametrize(
    "options, message",
    [
        ({}, r'say how many iterations: in the grammar \("iterations = 5"\) or as an argument'),
        ({"iterations": -1}, "iterations must be a whole number from 0, got -1"),
        ({"iterations": 1.5}, "iterations must be a whole number from 0, got 1.5"),
        ({"iterations": "3"}, "iterations must be a whole number from 0, got '3'"),
        ({"parameters": {"ab": 1}}, "the grammar has no param 'ab', did you mean \"abc\""),
        ({"parameters": {"zzz": 1}}, "the grammar has no param 'zzz'; it has abc"),
        ({"parameters": {"abc": float("nan")}}, "the parameter abc must be a finite number, got 'nan'"),
        ({"parameters": {"abc": 10**400}}, "the parameter abc must be a finite number, got '1000"),
        ({"parameters": {"abc": "1"}}, "the parameter abc must be a finite number, got '1'"),
    ],
)
def test_wrong_arguments(options, message):
    grammar = parse_grammar("param abc = 1\nconst d = 2\naxiom = F")
    with pytest.raises(DerivationError, match=f"^{message}") as caught:
        derive_word(grammar, **options)
    assert isinstance(caught.value, InputError)


@pytest.mark.parametrize(
    "text", ["axiom = F(uniform(0, 1))", "axiom = A\nA -> (1) F", "angle = normal(1, 2)\naxiom = F"]
)
def test_chance_needs_a_generator(text):
    with pytest.raises(
        DerivationError, match=r"draws random numbers: hand in a numpy\.random\.Generator as rng"
    ):
        derive_word(parse_grammar(text), iterations=1)


@pytest.mark.parametrize(
    "limits, message",
    [
        ({"modules": 0}, "modules must be from 1 to 50000000, got 0"),
        ({"modules": 10**9}, "modules must be from 1 to 50000000, got 1000000000"),
        ({"seconds": 0}, "seconds must be above 0, got 0"),
        ({"seconds": float("nan")}, "seconds must be above 0, got nan"),
        ({"iterations": -1}, "iterations must be 0 or more, got -1"),
    ],
)
def test_wrong_limits(limits, message):
    with pytest.raises(DerivationError, match=f"^{message}$"):
        DerivationLimits(**limits)


@pytest.mark.parametrize(
    "code, number, message",
    [
        ([[0]], [], r"code must have shape \(m,\) and be below 2, the number of kinds"),
        ([2], [], r"code must have shape \(m,\) and be below 2"),
        ([-1], [], r"code must have shape \(m,\) and be below 2"),
        ([0, 1], [], r"number must have shape \(1,\) to match the modules, got \(0,\)"),
        ([1], [np.inf], "the numbers of a word must be finite"),
    ],
)
def test_wrong_words(code, number, message):
    with pytest.raises(DerivationError, match=f"^{message}"):
        Word((("A", 0), ("F", 1)), np.array(code), np.array(number, float))
