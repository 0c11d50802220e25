"""Rules of blocks without a memory: sources, arithmetic, functions, tables, limits, logic."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .numbers import Raw, as_json, values_of_mat
from .signals import CONSTANT, CONTINUOUS, Own
from .systems import At, Refused, Rule

RULES: dict[str, Rule] = {}
"""Rules by BlockType; those of links into Simulink's own libraries by "Reference" and the type of the source."""
MOST_POINTS = 100_000  # of a lookup table


def rule(*types: str) -> Callable[[Rule], Rule]:
    """Register a rule."""

    def registered(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(types, function))
        return function

    return registered


def numbers(given: Sequence[Raw]) -> list[Any]:
    """Return the elements of a vector as a diagram has them."""
    if any(not math.isfinite(one.value) and one.value == one.value for one in given):
        raise Refused("a parameter is infinite", "Give it a finite value.")
    return [one.json for one in given]


def computed(formula: str, function: Callable[..., float], *given: Raw) -> Raw:
    """Return a number that follows from others, as an expression where one of them is an expression: "1/({})"."""
    value = function(*(one.value for one in given))
    if any(isinstance(one.json, str) for one in given):
        texts = [one.json.removeprefix("=") if isinstance(one.json, str) else repr(one.json) for one in given]
        return Raw("=" + formula.format(*(text if text.isidentifier() else f"({text})" for text in texts)), value)
    return Raw(as_json(value), value)


def divided(a: float, b: float) -> float:
    """Return a/b, and infinity for b = 0, which is refused where a number is needed."""
    return a / b if b else math.inf


def formula(at: At, expression: str, ports: Sequence[int] = (1,), k: Sequence[Sequence[Raw]] = (), *,
            is_bool: bool = False, suffix: str = "") -> None:  # fmt: skip
    """Add an Expression of inputs u1, u2, ... and constants k1, k2, ..., for each element."""
    n = at.width(*k, ports=ports)
    given: Any = None
    if k:
        rows = [[numbers(one)[0 if len(one) == 1 else i] for one in k] for i in range(n)]
        given = rows[0] if all(len(one) == 1 for one in k) else rows
    at.each("Expression", {f"u{i + 1}": port for i, port in enumerate(ports)}, suffix=suffix, is_bool=is_bool, n=n,
            expression=expression, k=given)  # fmt: skip


def over_elements(
    at: At, kind: str, /, *, port: int = 1, suffix: str = "", is_bool: bool = False, **parameters: Any
) -> None:
    """Add a block that takes the elements of one input, each at an input of its own."""
    name = at.add(kind, suffix, 1, **parameters)
    for i in range(at.attr(port).n):
        at.wire(f"{name}.u{i + 1}", at.own(port, i), is_bool=is_bool)
    at.out(f"{name}.y", at.inherited(), is_bool=is_bool)


# --- sources ---------------------------------------------------------------------------------------------------------


def _source(at: At, kind: str, lists: Mapping[str, Sequence[Raw]], rate: Any = CONTINUOUS, **parameters: Any) -> None:
    at.each(kind, {}, lists, rate=rate, **parameters)
    at.hold()


@rule("Constant")
def _(at: At) -> None:
    at.each("Constant", {}, {"value": at.raws("Value", "1")}, rate=CONSTANT)


@rule("Ground")
def _(at: At) -> None:
    at.add("Constant", value=0)
    at.out(f"{at.name}.y", CONSTANT)


@rule("Step")
def _(at: At) -> None:
    _source(at, "Step", {"at": at.raws("Time", "1"), "before": at.raws("Before", "0"), "after": at.raws("After", "1")})


@rule("Ramp", "Reference Ramp")
def _(at: At) -> None:
    lists = {"slope": at.raws("slope", "1"), "at": at.raws("start", "0"), "before": at.raws("X0", "0")}
    if "InitialOutput" in at.block.values:
        lists["before"] = at.raws("InitialOutput", "0")
    at.each("Ramp", {}, lists, rate=CONTINUOUS)


@rule("Sin")
def _(at: At) -> None:
    if at.text("TimeSource", "Use simulation time") != "Use simulation time":
        k = [
            at.raws(key, default)
            for key, default in (("Amplitude", "1"), ("Frequency", "1"), ("Phase", "0"), ("Bias", "0"))
        ]
        formula(at, "k1*sin(k2*u1 + k3) + k4", k=k)
        return
    lists = {"amplitude": at.raws("Amplitude", "1"), "bias": at.raws("Bias", "0")}
    if at.text("SineType", "Time based") == "Sample based":
        rate = at.ticks()
        samples, first = at.raw("Samples", "10"), at.raw("Offset", "0")
        period = Raw(rate.json, rate.period)
        lists["omega"] = [computed("2*pi/({}*{})", lambda a, b: divided(2 * math.pi, a * b), samples, period)]
        lists["phase"] = [computed("2*pi*{}/{}", lambda a, b: divided(2 * math.pi * a, b), first, samples)]
    else:
        lists |= {"omega": at.raws("Frequency", "1"), "phase": at.raws("Phase", "0")}
    _source(at, "Sine", lists)


@rule("DiscretePulseGenerator")
def _(at: At) -> None:
    names = ("Period", "PulseWidth", "PhaseDelay")
    period, width, delay = (at.raw(name, default) for name, default in zip(names, ("2", "1", "0"), strict=True))
    rate = CONTINUOUS
    if at.text("PulseType", "Sample based") == "Sample based":
        rate = at.ticks(default="1")
        tick = Raw(rate.json, rate.period)
        width = computed("100*{}/{}", lambda a, b: divided(100 * a, b), width, period)
        period = computed("{}*{}", lambda a, b: a * b, period, tick)
        delay = computed("{}*{}", lambda a, b: a * b, delay, tick)
    duty = computed("{}/100", lambda a: a / 100, width)
    at.each("SquareWave", {}, {"high": at.raws("Amplitude", "1")}, rate=rate, period=period.json, duty=duty.json,
            at=delay.json or None)  # fmt: skip


@rule("SignalGenerator")
def _(at: At) -> None:
    form, amplitude, frequency = at.text("WaveForm", "sine"), at.raws("Amplitude", "1"), at.raw("Frequency", "1")
    is_hertz = at.text("Units", "Hertz") == "Hertz"
    if form == "sine":
        omega = computed("2*pi*{}", lambda f: 2 * math.pi * f, frequency) if is_hertz else frequency
        at.each("Sine", {}, {"amplitude": amplitude}, rate=CONTINUOUS, omega=omega.json)
    elif form == "square":  # there it begins with the negative half
        period = computed(
            "1/{}" if is_hertz else "2*pi/{}", lambda f: divided(1 if is_hertz else 2 * math.pi, f), frequency
        )
        negative = [computed("-{}", lambda a: -a, one) for one in amplitude]
        at.each("SquareWave", {}, {"low": amplitude, "high": negative}, rate=CONTINUOUS, period=period.json)
    else:
        raise Refused(f"its wave is {form!r}", "Use Sine, SquareWave, Sawtooth or Noise.")


@rule("Clock")
def _(at: At) -> None:
    at.add("Expression", expression="t")
    at.out(f"{at.name}.y", CONTINUOUS)


@rule("DigitalClock")
def _(at: At) -> None:
    at.add("Expression", expression="t")
    at.out(f"{at.name}.y", CONTINUOUS)
    at.hold(default="1")


@rule("RandomNumber", "UniformRandomNumber", "Reference Band-Limited White Noise.", "Reference Continuous White Noise.")
def _(at: At) -> None:
    is_linked = at.block.type == "Reference"
    rate = at.ticks(*(("Ts", "0.1") if is_linked else ("SampleTime", "-1")))
    seed = at.raws("seed" if is_linked else "Seed", "0")[0].json
    words: dict[str, Any] = {"period": rate.json, "seed": seed or None}
    if is_linked:
        tick, root = Raw(rate.json, rate.period), lambda a, b: math.sqrt(divided(max(a, 0.0), b))
        deviation = [computed("sqrt({}/{})", root, one, tick) for one in at.raws("Cov", "[0.1]")]
        lists: dict[str, Sequence[Raw]] = {"deviation": deviation}
    elif at.block.type == "RandomNumber":
        deviation = [computed("sqrt({})", lambda a: math.sqrt(max(a, 0.0)), one) for one in at.raws("Variance", "1")]
        lists = {"mean": at.raws("Mean", "0"), "deviation": deviation}
    else:
        low, high = at.raw("Minimum", "-1"), at.raw("Maximum", "1")
        middle = computed("({}+{})/2", lambda a, b: (a + b) / 2, low, high)
        lists = {
            "mean": [middle],
            "deviation": [computed("({1}-{0})/sqrt(12)", lambda a, b: (b - a) / math.sqrt(12), low, high)],
        }
        words["distribution"] = "uniform"
    at.note("decided", "its random numbers have the same distribution, but are other numbers", "")
    at.each("Noise", {}, lists, rate=rate, **words)


@rule("FromWorkspace", "FromFile")
def _(at: At) -> None:
    if at.block.type == "FromFile":
        matrix = _of_file(at, at.text("FileName", "untitled.mat"))
        time, values = matrix[:1].T, matrix[1:].T
    else:
        held: Any = at.scope.value(at.text("VariableName", "simulink_input"))
        if isinstance(held, dict):
            signals = held.get("signals")
            time, values = held.get("time"), signals.get("values") if isinstance(signals, dict) else None
        else:
            time, values = (held[:, :1], held[:, 1:]) if isinstance(held, np.ndarray) else (None, None)
    is_table = isinstance(time, np.ndarray) and isinstance(values, np.ndarray) and time.size == len(values)
    if not is_table or not values.size or np.any(np.diff(time.ravel()) < 0):
        raise Refused("it has no increasing times with a value for each", "Give [t, y], or a structure with time.")
    if not (np.all(np.isfinite(time)) and np.all(np.isfinite(values))):
        raise Refused("its variable holds what is no number", "Give finite times and values.")
    after = at.text("OutputAfterFinalValue", "Extrapolation").lower()
    if "hold" not in after:
        at.note("decided", f"after its last time ({time.ravel()[-1]:g} s) it holds the last value; there: {after}", "")
    is_linear = at.text("Interpolate", at.text("InterpolationWithinTimeRange", "on")) not in ("off", "Zero order hold")
    columns = values.astype(float).T.tolist()
    given = {"times": time.ravel().astype(float).tolist(), "values": columns if len(columns) > 1 else columns[0]}
    at.add("Table", "", len(columns), **given, interpolation=None if is_linear else "hold")
    at.out(f"{at.name}.y", CONTINUOUS, len(columns))
    at.hold()


def _of_file(at: At, name: str) -> Any:
    """Return the matrix of a MAT file beside the model: times in its first row, signals in the others."""
    path = at.context.folder / name
    if not re.fullmatch(r"[\w.-]+", name) or not path.is_file():
        raise Refused(f"there is no {name} beside the model", "Put the file there.")
    held = [value for value in values_of_mat(path).values() if isinstance(value, np.ndarray)]
    if len(held) != 1 or len(held[0]) < 2:
        raise Refused(f"{name} holds no matrix with times in its first row", "Save it as an array there.")
    return held[0]


@rule("Reference Repeating table")
def _(at: At) -> None:
    times, values = numbers(at.raws("rep_seq_t", "[0 2]")), numbers(at.raws("rep_seq_y", "[0 2]"))
    end = at.raws("rep_seq_t", "[0 2]")[-1].json
    at.add("Expression", "_time", expression="mod(t, k1)", k=[end])
    at.add("LookupTable", points=times, values=values)
    at.wire(f"{at.name}.u", f"{at.name}_time.y")
    at.out(f"{at.name}.y", CONTINUOUS)


@rule("Reference chirp")
def _(at: At) -> None:
    first, last, duration = at.raw("f1", "0.1"), at.raw("f2", "1"), at.raw("T", "100")
    start, end = (computed("2*pi*{}", lambda f: 2 * math.pi * f, one) for one in (first, last))
    phase = math.pi / 2 if at.text("SourceType") == "cosine" else None
    at.note("decided", f"its frequency stays the same after {duration.json} s; there it goes on rising", "")
    at.add("Chirp", omega_start=start.json, omega_end=end.json, duration=duration.json, phase=phase)
    at.out(f"{at.name}.y", CONTINUOUS)


# --- arithmetic ------------------------------------------------------------------------------------------------------


@rule("Gain", "Reference Slider Gain")
def _(at: At) -> None:
    key = "gain" if at.block.type == "Reference" else "Gain"
    form = at.text("Multiplication", "Element-wise(K.*u)")
    if form.startswith("Matrix") and at.matrix(key, "1").size > 1:
        k = at.matrix(key, "1")
        k = k.T if "u*K" in form else k
        n = at.attr(1).n
        if n == 1 < k.shape[1] and len(k) > 1:
            raise Refused("its output is a matrix")
        if n == 1 < k.shape[1]:  # a row times a number is a row
            k = k.T
        if n != k.shape[1]:
            raise Refused(f"its matrix has {k.shape[1]} columns for an input of {n} elements")
        at.add("MatrixGain", K=k.tolist())
        at.wire(f"{at.name}.u", 1, k.shape[1], is_vector=True)
        at.out(f"{at.name}.y", at.inherited(), len(k), is_vector=True)
    else:
        at.each("Gain", {"u": 1}, {"k": at.raws(key, "1")})
    at.hold()


@rule("UnaryMinus")
def _(at: At) -> None:
    at.each("Gain", k=-1)


@rule("Bias")
def _(at: At) -> None:
    formula(at, "u1 + k1", k=[at.raws("Bias", "0")])


def signs_of(at: At, default: str, plain: str) -> str:
    """Return the signs of a Sum or Product, without the bars that only place its ports."""
    count = at.number_of("Inputs", default)
    return at.text("Inputs", default).replace("|", "").replace(" ", "") if count is None else plain * count


@rule("Sum")
def _(at: At) -> None:
    signs = signs_of(at, "++", "+")
    if not signs or set(signs) - {"+", "-"}:
        raise Refused(f"its signs are {signs[:20]!r}")
    if len(signs) == 1 and at.attr(1).n > 1:
        over_elements(at, "Sum", signs=signs * at.attr(1).n)
    else:
        at.each("Sum", {f"u{i + 1}": i + 1 for i in range(len(signs))}, signs=signs)
    at.hold()


@rule("Product")
def _(at: At) -> None:
    signs = signs_of(at, "2", "*")
    if not signs or set(signs) - {"*", "/"}:
        raise Refused(f"its operations are {signs[:20]!r}")
    ports = range(1, len(signs) + 1)
    if at.text("Multiplication", "Element-wise(.*)").startswith("Matrix") and any(at.attr(one).n > 1 for one in ports):
        raise Refused("a product of matrices", "Use MatrixGain or DotProduct.")
    if len(signs) == 1 and at.attr(1).n > 1:
        over_elements(at, "Product", operations=signs * at.attr(1).n)
    else:
        at.each("Product", {f"u{i}": i for i in ports}, operations=signs)
    at.hold()


@rule("DotProduct")
def _(at: At) -> None:
    n = at.width(ports=(1, 2))
    at.add("DotProduct", size=n)
    for i in (1, 2):
        at.wire(f"{at.name}.u{i}", i, n, is_vector=True)
    at.out(f"{at.name}.y", at.inherited())


# --- functions -------------------------------------------------------------------------------------------------------

_FIX = "(max({0} - mod({0}, 1), 0) + min({0} + mod(-({0}), 1), 0))"
_ROUND = "max(u1 + 0.5 - mod(u1 + 0.5, 1), 0) + min(u1 - 0.5 + mod(0.5 - u1, 1), 0)"
_OF_ONE = {
    "10^u": "10**u1", "magnitude^2": "u1**2", "square": "u1**2", "reciprocal": "1/u1",
    "floor": "u1 - mod(u1, 1)", "ceil": "u1 + mod(-u1, 1)", "round": _ROUND, "fix": _FIX.format("u1"),
    "1/sqrt": "1/sqrt(u1)", "rSqrt": "1/sqrt(u1)",
}  # fmt: skip
_OF_TWO = {
    "pow": "u1**u2", "hypot": "sqrt(u1**2 + u2**2)", "mod": "mod(u1, u2)",
    "rem": f"u1 - u2*{_FIX.format('u1/u2')}", "atan2": "atan2(u1, u2)",
}  # fmt: skip
_BLOCKS: dict[str, tuple[str, dict[str, Any]]] = {
    "exp": ("Exp", {}), "log": ("Log", {}), "log10": ("Log", {"base": "10"}), "sqrt": ("Sqrt", {}),
    "signedSqrt": ("Sqrt", {"form": "signed"}),
}  # fmt: skip


@rule("Math", "Sqrt", "Rounding")
def _(at: At) -> None:
    operator = at.text("Operator", {"Math": "exp", "Sqrt": "sqrt"}.get(at.block.type, "floor"))
    if operator in ("conj", "transpose", "hermitian"):
        at.pass_on()
        return
    if operator in _BLOCKS:
        kind, words = _BLOCKS[operator]
        at.each(kind, **words)
    elif operator in _OF_ONE:
        formula(at, _OF_ONE[operator])
    elif operator in _OF_TWO:
        formula(at, _OF_TWO[operator], (1, 2))
    else:
        raise Refused(f"its function is {operator!r}", "Use Expression.")
    at.hold()


@rule("Trigonometry")
def _(at: At) -> None:
    operator = at.text("Operator", "sin")
    if operator == "atan2":
        at.each("Atan2", {"u1": 1, "u2": 2})
    elif operator == "sincos":
        at.each("Trigonometry", function="sin")
        at.each("Trigonometry", function="cos", suffix="_cos", number=2)
    elif "j" in operator:
        raise Refused("its output is complex")
    else:
        at.each("Trigonometry", function=operator)
    at.hold()


@rule("Abs")
def _(at: At) -> None:
    at.each("Abs")
    at.hold()


@rule("Signum")
def _(at: At) -> None:
    at.each("Sign")


@rule("MinMax")
def _(at: At) -> None:
    function, n = at.text("Function", "min"), at.attr(1).n
    ports = at.number_of("Inputs", "1") or 1
    if ports > 1:
        at.each("MinMax", {f"u{i}": i for i in range(1, ports + 1)}, function=function, size=ports)
    elif n == 1:
        at.pass_on()
    else:
        at.add("Reduction", kind=function, size=n)
        at.wire(f"{at.name}.u", 1, n, is_vector=True)
        at.out(f"{at.name}.y", at.inherited())


@rule("Polyval")
def _(at: At) -> None:
    at.each("Polynomial", c=numbers(at.raws("Coefs", "[1 2]")))


@rule("Reference Coulombic and Viscous Friction")
def _(at: At) -> None:
    offset, gain = at.raws("offset", "[1 3 2 0]"), at.raws("gain", "1")
    n = at.width(offset, gain, ports=[1])
    name = at.each("Sign", suffix="_sign")
    at.each("Expression", {"u2": 1}, expression="u1*(k1*abs(u2) + k2)",
            k=[[g.json, o.json] for g, o in zip(gain * n if len(gain) == 1 else gain,
                                                offset * n if len(offset) == 1 else offset, strict=True)]
            if n > 1 else [gain[0].json, offset[0].json])  # fmt: skip
    at.wire(f"{at.name}.u1", f"{name}.y", n)


@rule("Fcn")
def _(at: At) -> None:
    text = at.text("Expr", "sin(u[1])")
    expression, elements, names, truths, is_bool = translated(text)
    n = max(elements, default=1)
    if n > max(at.attr(1).n, 1):
        raise Refused(f"its expression reads u({n}), and its input has {at.attr(1).n} elements")
    k = numbers([at.scope.raw(name) for name in names]) or None
    sources: list[str | Own] = [at.own(1, element - 1) for element in elements]
    for i, each in enumerate([*truths, expression], 1):
        suffix = f"_is_true_{i}" if i <= len(truths) else ""
        written = re.sub(r"\bc(\d+)\b", lambda found: f"u{len(elements) + int(found[1])}", each)
        at.add("Expression", suffix, expression=written, k=k if re.search(r"\bk\d", written) else None)
        for number in range(1, max([int(one) for one in re.findall(r"\bu(\d+)\b", written)], default=0) + 1):
            at.wire(f"{at.name}{suffix}.u{number}", sources[number - 1])
        if suffix:  # 1 or 0, an input of what comes after it
            at.add("Switch", f"_number_{i}")
            for port, one in (("u1", "1"), ("u2", "0"), ("control", f"{at.name}{suffix}.y")):
                at.wire(f"{at.name}_number_{i}.{port}", one)
            sources.append(f"{at.name}_number_{i}.y")
    at.out(f"{at.name}.y", at.inherited(), is_bool=is_bool)
    at.hold()


_SAME = {"abs", "acos", "asin", "atan", "atan2", "cos", "exp", "max", "min", "sin", "sqrt", "tan", "tanh"}
_OTHERS = {
    "ln": "log({0})", "log": "log({0})", "log10": "log({0})/log(10)", "log2": "log({0})/log(2)",
    "sinh": "(exp({0}) - exp(-({0})))/2", "cosh": "(exp({0}) + exp(-({0})))/2",
    "floor": "({0} - mod({0}, 1))", "ceil": "({0} + mod(-({0}), 1))", "fix": _FIX,
    "pow": "({0})**({1})", "power": "({0})**({1})", "hypot": "sqrt(({0})**2 + ({1})**2)", "mod": "mod({0}, {1})",
    "rem": "({0} - ({1})*" + _FIX.replace("{0}", "({0})/({1})") + ")", "square": "({0})**2",
}  # fmt: skip


def translated(text: str) -> tuple[str, list[int], list[str], list[str], bool]:
    """Return an expression of a Fcn, or a condition of an If, as a formula of an Expression block.

    With it come the elements of u that its inputs u1, u2, ... are (of an If: its inputs), the variables that its
    constants k1, k2, ... are, the conditions that it takes as numbers c1, c2, ..., and whether it is a condition.
    Raises Refused.
    """
    plain = re.sub(r"\bu\s*[(\[]\s*(\d+)\s*[)\]]", r"u\1", text.strip().rstrip(";"))
    for there, here in (("^", "**"), (".*", "*"), ("./", "/"), ("&&", " and "), ("||", " or "), ("~=", "!=")):
        plain = plain.replace(there, here)
    plain = re.sub(r"(?<![&<>=!])&(?!&)", " and ", plain)
    plain = re.sub(r"(?<!\|)\|(?!\|)", " or ", plain)
    plain = re.sub(r"[!~](?!=)", " not ", plain).replace("...", " ").strip()
    writer = _Writer()
    try:
        if len(plain) > 2000:
            raise ValueError
        written, is_bool = writer.written(ast.parse(" ".join(plain.split()), mode="eval").body)
    except (SyntaxError, ValueError, KeyError, RecursionError, MemoryError):
        raise Refused(f"its expression {text.strip()[:80]!r} has no equal here", "Write it as an Expression.") from None
    written = ast.unparse(ast.parse(written, mode="eval"))  # with no more brackets than it needs
    return written, writer.elements, writer.names, writer.truths, is_bool


class _Writer:
    """Writes the formula of an Expression block.

    elements, names: what its inputs and its constants are. truths: conditions whose values it takes as numbers.
    """

    def __init__(self) -> None:
        self.elements: list[int] = []
        self.names: list[str] = []
        self.truths: list[str] = []

    def written(self, node: ast.expr) -> tuple[str, bool]:
        """Return the text of an expression and whether it is a condition. Raises ValueError, KeyError."""
        if isinstance(node, ast.BoolOp):
            return "(" + f" {'and' if isinstance(node.op, ast.And) else 'or'} ".join(
                self._condition(one) for one in node.values
            ) + ")", True
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return f"(not {self._condition(node.operand)})", True
        if isinstance(node, ast.Compare):
            if len(node.ops) > 1:
                raise ValueError  # a < b < c is (a < b) < c there
            return f"({self._number(node.left)} {_SIGNS[type(node.ops[0])]} {self._number(node.comparators[0])})", True
        return self._arithmetic(node), False

    def _condition(self, node: ast.expr) -> str:
        text, is_bool = self.written(node)
        return text if is_bool else f"({text} != 0)"

    def _number(self, node: ast.expr) -> str:
        text, is_bool = self.written(node)
        return self._truth(text) if is_bool else text

    def _truth(self, condition: str) -> str:
        if condition not in self.truths:
            self.truths.append(condition)
        return f"c{self.truths.index(condition) + 1}"

    def _arithmetic(self, node: ast.expr) -> str:
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            return repr(node.value)
        if isinstance(node, ast.Name) and node.id != "t":
            if node.id == "pi":
                return "pi"
            if re.fullmatch(r"u\d*", node.id):
                element = int(node.id[1:] or "1")
                self.elements += [element] if element not in self.elements else []
                return f"u{self.elements.index(element) + 1}"
            self.names += [node.id] if node.id not in self.names else []
            return f"k{self.names.index(node.id) + 1}"
        if isinstance(node, ast.BinOp):
            if type(node.op) is ast.Pow and isinstance(node.right, ast.BinOp) and type(node.right.op) is ast.Pow:
                raise ValueError  # a^b^c is (a^b)^c there
            return f"({self._number(node.left)} {_SIGNS[type(node.op)]} {self._number(node.right)})"
        if isinstance(node, ast.UnaryOp) and type(node.op) in (ast.USub, ast.UAdd):
            return f"({_SIGNS[type(node.op)]}{self._number(node.operand)})"
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            inner, name = [self._number(one) for one in node.args], node.func.id
            if name in ("sgn", "sign") and len(inner) == 1:
                return f"({self._truth(f'({inner[0]} > 0)')} - {self._truth(f'({inner[0]} < 0)')})"
            if name in _SAME:
                return f"{name}({', '.join(inner)})"
            if name in _OTHERS and len(inner) == (2 if "{1}" in _OTHERS[name] else 1):
                return _OTHERS[name].format(*inner)
        raise ValueError


_SIGNS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**", ast.USub: "-", ast.UAdd: "+",
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip


# --- limits and tables -----------------------------------------------------------------------------------------------


@rule("Saturate")
def _(at: At) -> None:
    lists = {"lower": at.raws("LowerLimit", "-0.5"), "upper": at.raws("UpperLimit", "0.5")}
    at.each("Saturation", {"u": 1}, lists, limits=lists)
    for name in at.part.blocks:  # an end without a limit
        given = at.part.blocks[name].setdefault("parameters", {})
        given.setdefault("lower", -1e100)
        given.setdefault("upper", 1e100)
    at.hold()


@rule("DeadZone")
def _(at: At) -> None:
    at.each("DeadZone", {"u": 1}, {"lower": at.raws("LowerValue", "-0.5"), "upper": at.raws("UpperValue", "0.5")})
    at.hold()


@rule("Quantizer")
def _(at: At) -> None:
    at.each("Quantizer", {"u": 1}, {"interval": at.raws("QuantizationInterval", "0.5")})
    at.hold()


@rule("Lookup", "Lookup_n-D", "Lookup2D")
def _(at: At) -> None:
    kind = at.block.type
    dimensions = 2 if kind == "Lookup2D" else 1 if kind == "Lookup" else at.whole_number("NumberOfTableDimensions", "2")
    if kind == "Lookup":
        method = at.text("LookUpMeth", "Interpolation-Extrapolation")
        points, keys = (
            [at.matrix("InputValues", "[-4:5]").ravel()],
            ("Table" if "Table" in at.block.values else "OutputValues",),
        )
        interpolation = "hold" if method == "Use Input Below" else "linear" if method.startswith("Interp") else method
        beyond = "linear" if method == "Interpolation-Extrapolation" else "hold"
    elif kind == "Lookup2D":
        points = [at.matrix(key, "[0 1]").ravel() for key in ("RowIndex", "ColumnIndex")]
        keys, method = ("Table",), at.text("LookUpMeth", "Interpolation-Extrapolation")
        interpolation, beyond = "linear", "linear" if method == "Interpolation-Extrapolation" else "hold"
    else:
        points, keys = [_breakpoints(at, i) for i in range(1, dimensions + 1)], ("Table",)
        method = at.text("InterpMethod", "Linear point-slope")
        interpolation = "linear" if method.startswith("Linear") else "hold" if method == "Flat" else method
        beyond = (
            "linear" if at.text("ExtrapMethod", "Linear").startswith("Linear") and interpolation == "linear" else "hold"
        )
    if (
        interpolation not in ("linear", "hold")
        or dimensions not in (1, 2)
        or (dimensions == 2 and interpolation == "hold")
    ):
        raise Refused(f"a table of {dimensions} dimensions with {interpolation!r}", "Use LookupTable or LookupTable2D.")
    values = at.matrix(keys[0], {"Lookup2D": "[0 0; 0 0]", "Lookup_n-D": "[4 5 6; 16 19 20; 10 18 23]"}.get(kind, ""))
    if values.size > MOST_POINTS:
        raise Refused(
            f"its table has {values.size:,} values, and {MOST_POINTS:,} are the most", "Use a Table of a file."
        )
    if dimensions == 1:
        if values.size != points[0].size:
            raise Refused(f"its table has {values.size} values for {points[0].size} points")
        at.each("LookupTable", points=points[0].tolist(), values=values.ravel().tolist(), beyond=beyond,
                interpolation=None if interpolation == "linear" else interpolation)  # fmt: skip
    else:
        if values.shape != (points[0].size, points[1].size):
            raise Refused(
                f"its table is {values.shape[0]} x {values.shape[1]} for {points[0].size} x {points[1].size} points"
            )
        if beyond == "linear":
            at.note(
                "decided",
                "beyond its table the last value is held; there the last lines go on",
                "Make the table larger.",
            )
        at.each(
            "LookupTable2D",
            {"u1": 1, "u2": 2},
            points1=points[0].tolist(),
            points2=points[1].tolist(),
            values=values.tolist(),
        )
    at.hold()


def _breakpoints(at: At, i: int) -> Any:
    if at.text("BreakpointsSpecification", "Explicit values") == "Even spacing":
        first, step = (at.raw(f"BreakpointsForDimension{i}{key}", "1").value for key in ("FirstPoint", "Spacing"))
        table = at.matrix("Table", "0")
        if not math.isfinite(first) or not math.isfinite(step):
            raise Refused("its breakpoints are infinite", "Give finite ones.")
        return first + step * np.arange(table.size if 1 in table.shape else table.shape[i - 1])
    return at.matrix(f"BreakpointsForDimension{i}", "[10 22 31]").ravel()


# --- logic -----------------------------------------------------------------------------------------------------------

_RELATIONS = {"==": "equal", "~=": "unequal", "!=": "unequal", "<": "<", "<=": "<=", ">": ">", ">=": ">="}


def _relation(at: At, key: str, default: str) -> str:
    operator = at.text(key, default)
    if operator not in _RELATIONS:
        raise Refused(f"its operator is {operator!r}")
    return _RELATIONS[operator]


@rule("RelationalOperator")
def _(at: At) -> None:
    at.each(
        "Compare",
        {"u1": 1, "u2": 2},
        operator=_relation(at, "Operator" if "Operator" in at.block.values else "relop", ">="),
        is_bool=True,
    )


@rule("CompareToConstant", "Reference Compare To Constant", "Reference Compare To Zero")
def _(at: At) -> None:
    constant = [Raw(0, 0.0)] if "Zero" in at.block.values.get("SourceType", "") else at.raws("const", "3.0")
    at.each("CompareToConstant", {"u": 1}, {"constant": constant}, operator=_relation(at, "relop", "<="), is_bool=True)


@rule("Reference Interval Test")
def _(at: At) -> None:
    left, right = ("<=" if at.is_on(f"IntervalClosed{side}", "on") else "<" for side in ("Left", "Right"))
    formula(
        at, f"k1 {left} u1 and u1 {right} k2", k=[at.raws("lowlimit", "-0.5"), at.raws("uplimit", "0.5")], is_bool=True
    )


@rule("Logic")
def _(at: At) -> None:
    operator = at.text("Operator", "AND").lower()
    ports = 1 if operator == "not" else at.number_of("Inputs", "2") or 2
    if operator not in ("and", "or", "nand", "nor", "xor", "nxor", "not"):
        raise Refused(f"its operator is {operator!r}")
    inner, suffix = ("xor", "_xor") if operator == "nxor" else (operator, "")
    if ports == 1 and operator != "not":
        over_elements(at, "Logic", suffix=suffix, is_bool=True, operator=inner, size=at.attr(1).n)
    else:
        sinks = {f"u{i}": i for i in range(1, ports + 1)}
        at.each(
            "Logic", sinks, operator=inner, size=None if ports == 2 else ports, suffix=suffix, bools=sinks, is_bool=True
        )
    if suffix:
        out = at.part.outs["1"]
        at.add("Logic", "", out.attr.n, operator="not", size=1)
        at.wire(f"{at.name}.u1", f"{at.name}{suffix}.y", out.attr.n, is_bool=True)
        at.out(f"{at.name}.y", out.attr.rate, out.attr.n, is_bool=True)


@rule("Switch")
def _(at: At) -> None:
    form, threshold = at.text("Criteria", "u2 >= Threshold"), at.raws("Threshold", "0")
    ports = {"u1": 1, "u2": 3, "control": 2}
    if form == "u2 ~= 0" or (
        at.attr(2).is_bool
        and len(threshold) == 1
        and (0 <= threshold[0].value < 1 if form == "u2 > Threshold" else 0 < threshold[0].value <= 1)
    ):
        at.each("Switch", ports, bools=["control"])
    elif form == "u2 > Threshold":
        n = at.attr(2).n
        name = at.add("CompareToConstant", "_above", n, operator=">", constant=at.per_copy(threshold, n) or None)
        at.wire(f"{name}.u", 2, n)
        at.each("Switch", {"u1": 1, "u2": 3})
        at.wire(f"{at.name}.control", f"{name}.y", n)
    else:
        at.each("SwitchAbove", ports, {"threshold": threshold})
    at.hold()


@rule("MultiPortSwitch")
def _(at: At) -> None:
    size = at.count(4) - 1
    order = at.text("DataPortOrder", "Zero-based contiguous" if at.is_on("zeroidx") else "One-based contiguous")
    if order == "Specify indices":
        raise Refused("its indices are given one by one", "Use contiguous indices.")
    is_from_0 = order.startswith("Zero")
    n = at.attr(2).n
    if size == 1 and n > 1:
        over_elements(at, "MultiportSwitch", port=2, size=n)
    else:
        at.each("MultiportSwitch", {f"u{i}": i + 1 for i in range(1, size + 1)}, size=size)
    at.add("Expression", "_index", expression=f"u1 {'+' if is_from_0 else '-'} 0.5")  # cut off there, rounded here
    at.wire(f"{at.name}_index.u1", 1)
    at.wire(f"{at.name}.index", f"{at.name}_index.y")
    at.hold()


@rule("ManualSwitch")
def _(at: At) -> None:
    chosen = 1 if at.text("sw", at.text("CurrentSetting", "1")) == "1" else 2
    at.note("decided", f"it passes input {chosen}, as it was saved", "")
    at.pass_on(chosen)
