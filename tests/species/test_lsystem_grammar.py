"""The grammar's language: what is read, how it is written back, what each error says, and any text at all."""

import pickle
from time import perf_counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from species import (
    DerivationError,
    DerivationLimits,
    Grammar,
    GrammarError,
    derive_word,
    draw_word,
    parse_grammar,
)
from species.lsystem.syntax import (
    COMMANDS,
    FUNCTIONS,
    Binary,
    Branch,
    Call,
    Constant,
    Module,
    Name,
    Number,
    Pattern,
    Production,
    Unary,
)
from treegraph import InputError, SapwoodError

TREE = """
    # a tree of two kinds of branches
    param r1 = 0.9
    param r2 = 0.7
    const half = sqrt(0.5)
    angle = 45
    width = 0.2
    iterations = 6
    tropism = 0, 0.1, -1
    axiom = ~(0.1) A(1, 10)
    A(l, w) : l > 0.1 ->
        !(w) F(l)               # the axis
        [ &(45) B(l * r2, w * half) ]
        /(137.5) A(l * r1, w * half)
    B(l, w) -> (0.5) !(w) F(l) [ -$ B(l * r2, w * half) ] L(0.1, 1)
    B(l, w) -> (0.5) !(w) F(l) L(uniform(0.05, 0.1))
"""
SIGNAL = """
module Bud(age), Idle
ignore + - Idle
leaf = 0.2
axiom = F Bud(0) [+ F Idle Bud(1)] [- F] F Bud(2)
F < Bud(a) > [F Bud(b)] [F] F Bud(c) : a < b and not (b >= c or c = 7) -> Bud(b + c) L
Bud(a) : a > 3 and a % 2 != 0 -> Bud(a / 2 - 1)
F -> (0.25) FF
F -> (1 - 0.25) F
"""
PLANT = "axiom = X\nangle 25\nX -> F[+X]F[-X]+X\nF -> FF"
VALID = (TREE, SIGNAL, PLANT)


def expression(text):
    return parse_grammar(f"const x = 1\nconst y = 2\nconst value = {text}\naxiom = F").constants[-1].value


def value(text, rng=None):
    """What the evaluator makes of an expression."""
    grammar = parse_grammar(f"axiom = F({text})\niterations = 0")
    return float(derive_word(grammar, rng=rng).number[0])


# ---------------------------------------------------------------- what is read


def test_productions_have_their_parts():
    grammar = parse_grammar(
        "module Ab C(x)\naxiom = Ab C(1) F\nAb < C(x) > [F] F : x > 2 -> (0.5) F(x)[+C(x)]"
    )
    assert grammar.productions == (
        Production(
            Pattern("C", ("x",)),
            (
                Module("F", (Name("x"),)),
                Module("["),
                Module("+"),
                Module("C", (Name("x"),)),
                Module("]"),
            ),
            left=(Pattern("Ab"),),
            right=(Branch((Pattern("F"),)), Pattern("F")),
            condition=Binary(">", Name("x"), Number(2.0)),
            weight=Number(0.5),
        ),
    )
    assert grammar.productions[0].place == (3, 1)
    assert grammar.productions[0].successor[3].place == (3, 42)


def test_statements_are_kept():
    grammar = parse_grammar(TREE)
    assert grammar.parameters == ("r1", "r2")
    assert grammar.constants[2] == Constant("half", Call("sqrt", (Number(0.5),)), False)
    assert list(grammar.settings) == ["angle", "width", "iterations", "tropism"]
    assert grammar.settings["tropism"] == (Number(0.0), Number(0.1), Unary("-", Number(1.0)))
    assert [p.predecessor.name for p in grammar.productions] == ["A", "B", "B"]
    assert grammar.is_random
    assert not parse_grammar(PLANT).is_random
    assert parse_grammar(SIGNAL).ignore == ("+", "-", "Idle")


@pytest.mark.parametrize(
    "text, shown",
    [
        ("1 + 2 * 3", "1 + (2 * 3)"),
        ("1 - 2 - 3", "(1 - 2) - 3"),
        ("2 ^ 3 ^ 2", "2 ^ (3 ^ 2)"),
        ("2 ** 3", "2 ^ 3"),
        ("-2 ^ 2", "-(2 ^ 2)"),
        ("2 ^ -1", "2 ^ (-1)"),
        ("-x * y", "(-x) * y"),
        ("+x", "x"),
        ("x < 1 and y > 2 or not x = y", "((x < 1) and (y > 2)) or (not (x == y))"),
        ("x < 1 && y > 2 || x != y", "((x < 1) and (y > 2)) or (x != y)"),
        ("not x + 1 > 2", "not ((x + 1) > 2)"),
        ("x % 2 / y", "(x % 2) / y"),
        ("max(x, 1, y) + if(x > y, x, y)", "max(x, 1, y) + if(x > y, x, y)"),
        (".5 + 1. + 2e-3", "(0.5 + 1) + 0.002"),
        ("((x))", "x"),
    ],
)
def test_operators_bind_as_documented(text, shown):
    from species.lsystem.syntax import format_expression

    assert format_expression(expression(text)) == shown
    assert expression(shown) == expression(text)


@pytest.mark.parametrize(
    "text, wanted",
    [
        ("1 + 2 * 3 - 4 / 2", 5),
        ("-2 ^ 2", -4),
        ("7 % 4 + -7 % 4", 4),
        ("sin(30)", 0.5),
        ("cos(60) + tan(45)", 1.5),
        ("asin(0.5) + acos(0.5) + atan(1) + atan2(1, -1)", 30 + 60 + 45 + 135),
        ("sqrt(16) + exp(0) + log(exp(2))", 7),
        ("min(3, 1, 2) + max(1, 2)", 3),
        ("abs(-2) + floor(-1.5) + ceil(1.2) + sign(-3)", 1),
        ("if(2 > 1, 10, 20)", 10),
        ("if(0, 1 / 0, 3)", 3),
        ("(1 < 2) + (1 <= 1) + (1 > 2) + (2 >= 2) + (1 = 1) + (1 != 1)", 4),
        ("(1 and 0) + (1 or 0) + not 0", 2),
    ],
)
def test_values(text, wanted):
    assert value(text) == pytest.approx(wanted, rel=1e-14)


def test_random_functions_have_their_distributions():
    rng = np.random.default_rng(5)
    grammar = parse_grammar(f"axiom = {'F(uniform(2, 5), normal(3, 2))' * 2000}\niterations = 0")
    drawn = derive_word(grammar, rng=rng).number.reshape(-1, 2)
    assert 2 <= drawn[:, 0].min() < 2.01
    assert 4.99 < drawn[:, 0].max() < 5
    assert drawn.mean(axis=0) == pytest.approx([3.5, 3], abs=5 * 2 / np.sqrt(2000))
    assert drawn.std(axis=0) == pytest.approx([3 / np.sqrt(12), 2], rel=0.1)


def test_lines_go_on_where_they_are_indented():
    flat = parse_grammar("axiom = A\nA -> F [+A] A\n")
    assert parse_grammar("axiom = A\nA ->\n  F\n\n # a remark\n\t[+A] # another\n A") == flat
    assert parse_grammar("   axiom =\n     A\n   A -> F [+A] A") == flat
    assert parse_grammar("axiom = A\r\nA -> F[+A]A\r\n") == flat


def test_names_of_several_letters_are_found_longest_first():
    grammar = parse_grammar("module Le, Leaf L2\naxiom = LeafLeL2L\n")
    assert [m.name for m in grammar.axiom] == ["Leaf", "Le", "L2", "L"]
    assert [m.name for m in parse_grammar("axiom = 12F\n1 -> 2\n2 -> 1").axiom] == ["1", "2", "F"]


def test_arrow_is_no_minus():
    grammar = parse_grammar("axiom = +-\n- -> +\n+ ->-\nA->")
    assert [(p.predecessor.name, [m.name for m in p.successor]) for p in grammar.productions] == [
        ("-", ["+"]),
        ("+", ["-"]),
        ("A", []),
    ]


@pytest.mark.parametrize("text", VALID)
def test_text_of_a_grammar_is_read_as_the_same_grammar(text):
    grammar = parse_grammar(text)
    again = parse_grammar(str(grammar))
    assert again == grammar
    assert str(again) == str(grammar)
    assert pickle.loads(pickle.dumps(grammar)) == grammar


# ---------------------------------------------------------------- what is refused

DEEP = "(" * 200 + "1" + ")" * 200


@pytest.mark.parametrize(
    "text, place, message",
    [
        ("", (1, 1), 'a grammar needs an axiom, as in "axiom = A"'),
        (
            "axiom = A\nA -> F(1",
            (2, 9),
            'expected "," or "\\)", got the end of the statement in "A -> F\\(1"',
        ),
        ("axiom = A\nA -> F(1]", (2, 9), 'expected "," or "\\)", got "\\]" in "A -> F\\(1\\]"'),
        ("axiom = A\nA(x -> F", (2, 5), 'expected "," or "\\)", got "->"'),
        ("axiom = A\nA(1) -> F", (2, 3), 'expected a parameter\'s name, got "1"'),
        ("axiom = A\nA(sin) -> F", (2, 3), '"sin" is the name of a function or an operator'),
        ("axiom = A\nA => F", (2, 3), 'expected "->", got "="'),
        ("axoim = A", (1, 7), 'expected "->" \\(did you mean "axiom"\\?\\), got "="'),
        ("axiom = A\n= 3", (2, 1), 'expected a module or a statement, got "="'),
        ("axiom = A\nAB -> F", (2, 1), "one module is replaced at a time, got 2"),
        ("axiom = A\n-> F", (2, 1), "one module is replaced at a time, got 0"),
        ("axiom = A\nA < -> F", (2, 1), "one module is replaced at a time, got 0"),
        ("axiom = A\nA > -> F", (2, 5), 'expected a module of the right context, got "->"'),
        ("axiom = A\nA > [F -> F", (2, 8), 'expected a module or "\\]", got "->"'),
        ("axiom = A\nA > F] -> F", (2, 6), 'expected "->", got "\\]"'),
        (f"axiom = A\n{'F' * 17} < A -> F", (2, 1), "a context has at most 16 modules, got 17"),
        (f"axiom = A\nA > {'F' * 17} -> F", (2, 5), "a context has at most 16 modules"),
        (f"axiom = A\nA > {'[' * 40} -> F", (2, 5), "a right context has at most 16 branches"),
        ("axiom = A\nA -> [F", (2, 6), '"\\[" is not closed before the end of the statement'),
        ("axiom = A\nA -> F]", (2, 7), '"\\]" closes no "\\["'),
        ("axiom = [(1)F]", (1, 9), '"\\[" has no parameters'),
        ("axiom = A\nA -> (1 F", (2, 9), 'expected "\\)", got "F"'),
        ("axiom = A\nA -> F : 1", (2, 8), 'expected a module, got ":"'),
        ("axiom = A ?", (1, 11), 'expected a module, got "\\?"'),
        ("axiom = A \xa0", (1, 11), "expected a module, got the character U\\+00A0"),
        ("axiom = A\nA : -> F", (2, 5), 'expected a number, a name or a function, got "->"'),
        ("axiom = A\nA : 1 < 2 < 3 -> F", (2, 11), "comparisons do not chain"),
        ("axiom = F(2x)", (1, 12), 'expected "," or "\\)", got "x"'),
        ("axiom = F(1 and)", (1, 16), 'expected a number, a name or a function, got "\\)"'),
        ("axiom = F(or)", (1, 11), 'expected a number, a name or a function, got "or"'),
        ("axiom = F(1e999)", (1, 11), "1e999 is too large, numbers go up to about 1e308"),
        ("axiom = F(sin)", (1, 14), 'expected "\\(" after the function sin, got "\\)"'),
        ("axiom = F(sin(1, 2))", (1, 11), "sin takes 1 argument, got more than 1"),
        ("axiom = F(atan2(1))", (1, 11), "atan2 takes 2 arguments, got 1"),
        ("axiom = F(min(1))", (1, 11), "min takes 2 to 12 arguments, got 1"),
        ("axiom = F(if(1, 2)", (1, 11), "if takes 3 arguments, got 2"),
        (f"axiom = F({DEEP})", (1, 131), "at most 40 operations inside each other"),
        (f"axiom = F({'-' * 200}1)", (1, 131), "at most 40 operations inside each other"),
        (f"axiom = F({'1+' * 200}1)", (1, 90), "at most 40 operations inside each other"),
        (f"axiom = F({'1^' * 200}1)", (1, 251), "at most 40 operations inside each other"),
        (f"axiom = F({'abs(' * 50}1{')' * 50})", (1, 51), "at most 40 operations inside each other"),
        ("axiom = A(1, 2, 3, 4, 5, 6, 7, 8, 9)", (1, 36), "a module has at most 8 parameters"),
        ("axiom = A\nA(a,b,c,d,e,f,g,h,i) -> F", (2, 20), "a module has at most 8 parameters"),
        ("axiom = A\naxiom = B", (2, 1), '"axiom" may stand in a grammar once'),
        ("angle = 1\nangle = 2", (2, 1), '"angle" may stand in a grammar once'),
        ("ignore = F\nignore = F", (2, 1), '"ignore" may stand in a grammar once'),
        ("ignore = 1 ;", (1, 12), 'expected a module\'s name, got ";"'),
        ("angle = 1 2", (1, 11), 'expected the end of the statement, got "2"'),
        ("tropism = 1, 2", (1, 15), 'expected "," and the next of three numbers, got the end of the stat'),
        ("const = 3", (1, 7), 'expected a name after const, got "="'),
        ("param x 3", (1, 9), 'expected "=", got "3"'),
        (f"const {'x' * 33} = 3", (1, 7), "a name has at most 32 characters, got 33"),
        (f"axiom = F({'x' * 99})", (1, 11), "a name has at most 32 characters, got 99"),
        ("const x = 1\nconst x = 2\naxiom = F", (2, 7), '"x" has a value already'),
        ("const x = y\nconst y = 2\naxiom = F", (1, 11), '"y" is not a parameter or a constant before x'),
        ("module", (1, 7), "expected a module's name, got the end of the statement"),
        ("module 1", (1, 8), 'expected a module\'s name, got "1"'),
        ("module axiom", (1, 8), '"axiom" has a meaning already; take another name for the module'),
        ("module F", (1, 8), '"F" has a meaning already'),
        ("module A A\naxiom = A", (1, 10), 'the module "A" is declared twice'),
        ("module A(x, x)\naxiom = A(1, 2)", (1, 8), '"x" is the name of two parameters'),
        (
            "axiom = F(lenght)\nconst length = 1",
            (1, 11),
            '"lenght" is not .* in the axiom, did you mean "length"',
        ),
        ("angle = a\naxiom = F", (1, 9), '"a" is not a parameter or a constant in angle'),
        (
            "axiom = A(1)\nA(x) : y > 1 -> F",
            (2, 8),
            '"y" is not a parameter or a constant of this production',
        ),
        ("axiom = A(1)\nA(x) -> (y) F", (2, 10), '"y" is not a parameter'),
        ("axiom = A(1)\nA(x) -> F(y)", (2, 11), '"y" is not a parameter'),
        ("axiom = A(1)\nA(x) < A(x) -> F", (2, 8), '"x" is the name of two parameters; rename one of them'),
        ("const x = 1\naxiom = A(1)\nA(x) -> F", (3, 1), 'the parameter "x" has the name of a constant'),
        ("axiom = Leaf", (1, 10), '"e" is no turtle command, has no production .* write "module e"'),
        ("axiom = F7", (1, 10), 'the module "7" has no production and stands in no context'),
        ("axiom = A(1)\nA -> F", (2, 1), '"A" has 0 parameters here and 1 in line 1'),
        ("module A(x)\naxiom = A(1, 2)", (2, 9), '"A" has 2 parameters here and 1 in line 1'),
        (
            "axiom = F(1)\nF -> FF(1)\nF(x, y) -> F",
            (3, 1),
            '"F" never occurs with 2 parameters, so this never',
        ),
        ("ignore = F\naxiom = A\nF < A -> A", (3, 1), '"F" is ignored, so it cannot be a context'),
        ("ignore = F\naxiom = A\nA > [F] -> A", (3, 6), '"F" is ignored, so it cannot be a context'),
        ("#" * 100_001, (1, 100_001), "a grammar has at most 100000 characters, got 100001"),
    ],
)
def test_errors_say_where_and_what(text, place, message):
    with pytest.raises(GrammarError, match=f"^line {place[0]}, column {place[1]}: {message}") as caught:
        parse_grammar(text)
    assert (caught.value.line, caught.value.column) == place
    assert "\n" not in str(caught.value)


def test_errors_are_the_user_s_and_name_the_file():
    with pytest.raises(InputError, match=r"^oak\.toml: line 1, column 1: ") as caught:
        parse_grammar("", name="oak.toml")
    assert isinstance(caught.value, SapwoodError)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), again.line, again.column) == (str(caught.value), 1, 1)


def test_errors_show_the_middle_of_a_long_line():
    text = "axiom = " + "F" * 300 + "?" + "F" * 300
    with pytest.raises(GrammarError, match=r'got "\?" in "\.\.\.F{24}\?F{23}\.\.\."$'):
        parse_grammar(text)


def test_a_sum_of_forty_terms_is_not_too_deep():
    assert value("+".join(["1"] * 40)) == 40
    assert value("-" * 39 + "1") == -1
    assert value("abs(" * 39 + "1" + ")" * 39) == 1


# ---------------------------------------------------------------- any text

NAMES = st.sampled_from(["x", "y", "z"])
EXPRESSIONS = st.recursive(
    st.one_of(NAMES.map(Name), st.floats(0, 1e300).map(Number)),
    lambda part: st.one_of(
        st.builds(Unary, st.sampled_from(["-", "not"]), part),
        st.builds(
            Binary,
            st.sampled_from(["+", "-", "*", "/", "%", "^", "<", "<=", ">", ">=", "==", "!=", "and", "or"]),
            part,
            part,
        ),
        st.sampled_from(sorted(FUNCTIONS)).flatmap(
            lambda f: st.lists(part, min_size=FUNCTIONS[f][0], max_size=FUNCTIONS[f][0]).map(
                lambda parts: Call(f, tuple(parts))
            )
        ),
    ),
    max_leaves=12,
)
COMMAND = st.sampled_from([c for c in COMMANDS if c not in "[]"])
MODULES = st.lists(st.builds(Module, COMMAND, st.lists(EXPRESSIONS, max_size=2).map(tuple)), max_size=5)


@given(MODULES, st.lists(st.tuples(MODULES, EXPRESSIONS, EXPRESSIONS), max_size=3))
@settings(deadline=None)
def test_any_grammar_is_read_as_it_is_written(axiom, rules):
    constants = tuple(Constant(name, Number(1.0), name == "x") for name in "xyz")
    branched = [Module("["), *axiom, Module("]"), Module("A", (Number(1.0), Number(2.0)))]
    productions = tuple(
        Production(Pattern("A", ("a", "b")), tuple(modules), condition=condition, weight=weight)
        for modules, condition, weight in rules
    )
    grammar = Grammar(
        tuple(branched) if productions else tuple(axiom), productions, constants, {"angle": (Number(30.0),)}
    )
    assert parse_grammar(str(grammar)) == grammar


LARGE = 100_000
SMALL = DerivationLimits(modules=2_000, seconds=1.0)


def try_everything(text):
    """Parse, print, derive and draw; whatever is wrong must be said as an InputError, and soon."""
    start = perf_counter()
    try:
        grammar = parse_grammar(text)
    except GrammarError as error:
        assert "\n" not in str(error)
        assert error.line >= 1
        assert error.column >= 1
    else:
        if len(str(grammar)) <= LARGE:
            assert parse_grammar(str(grammar)) == grammar
        try:
            word = derive_word(grammar, rng=np.random.default_rng(0), iterations=4, limits=SMALL)
            draw_word(word)
            assert word.n_modules <= SMALL.modules
        except DerivationError as error:
            assert "\n" not in str(error)
    assert perf_counter() - start < 5.0


ALPHABET = "AFfXL12 \n\t[]()<>:-+&^\\/|$!~,.=*%#xyeE09\0\xa0é"
WORDS = [
    "axiom",
    "const",
    "param",
    "module",
    "ignore",
    "angle",
    "iterations",
    "->",
    "A -> ",
    "F(",
    "uniform(0, 1)",
]
TEXT = st.lists(st.one_of(st.sampled_from(ALPHABET), st.sampled_from(WORDS)), max_size=60).map("".join)


@st.composite
def mutated(draw):
    """A valid grammar with pieces cut out, doubled, swapped or put in."""
    text = draw(st.sampled_from(VALID))
    for _ in range(draw(st.integers(1, 5))):
        at = draw(st.integers(0, len(text)))
        end = draw(st.integers(at, min(len(text), at + 20)))
        piece = text[at:end]
        put = draw(
            st.one_of(st.just(""), st.just(piece * 2), st.just(piece[::-1]), TEXT, st.text(max_size=3))
        )
        text = text[:at] + put + text[end:]
    return text


@given(st.one_of(st.text(max_size=200), TEXT, TEXT.map(lambda t: "axiom = F\n" + t)))
@settings(deadline=None)
def test_any_text_is_read_or_refused(text):
    try_everything(text)


@given(mutated())
@settings(deadline=None)
def test_mutated_grammars_are_read_or_refused(text):
    try_everything(text)


@pytest.mark.slow
@given(st.one_of(mutated(), TEXT, TEXT.map(lambda t: "axiom = F\n" + t), st.text()))
@settings(deadline=None, max_examples=20_000)
def test_many_texts_are_read_or_refused(text):
    try_everything(text)


@pytest.mark.parametrize(
    "text",
    [
        "axiom = " + "F" * (LARGE - 8),
        "axiom = " + "[" * (LARGE // 2 - 8) + "]" * (LARGE // 2 - 8),
        "axiom = F(" + "(" * (LARGE - 20),
        "axiom = F(" + "9" * (LARGE - 20) + ")",
        "axiom = F(0." + "9" * (LARGE - 20) + ")",
        "module " + "a" * (LARGE - 20),
        "module " + " ".join(f"m{k}" for k in range(12_000)) + "\naxiom = F",
        "axiom = F\n" + "A:1<2->(1)F\n" * 8_000,
        "\n".join(f"const c{k} = {k}" for k in range(4_000)) + "\naxiom = " + "F(1)" * 5_000,
        "\n" * (LARGE - 9) + "axiom = F",
        "#" * (LARGE - 10) + "\naxiom = F",
        "a" * LARGE,
        "axiom = F\nF -> " + "FF" * 40_000,
        "axiom = " + "I" * 20_000 + "[F]" * 20_000 + "\nmodule J\nignore = I\nI > J -> I",
    ],
    ids=lambda text: text[:12],
)
def test_large_texts_take_no_long_time(text):
    assert len(text) <= LARGE
    try_everything(text)


def test_nothing_is_run_as_python():
    for text in ("__import__('os')", "open(1)", "(lambda: 1)()", "().__class__", '"a"', "x.real", "[1]"):
        with pytest.raises(GrammarError):
            parse_grammar(f"const x = 1\naxiom = F({text})")
