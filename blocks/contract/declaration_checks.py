"""What a declaration must hold as a whole: every name that is read exists, every variable has what it needs, once."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from ..text.errors import did_you_mean
from .declaration import APART, DESCRIBING, Declaration
from .equations import Crossing, Output
from .reads import arguments, refuse
from .unit_expression import UnitExpression
from .variables import Discrete, Equation, Input, Parameter, State, Stepped, Variable


def check_declaration(declaration: Declaration) -> None:
    """Refuse what can be refused without numbers. Raises DeclarationError (E402 to E405)."""
    if declaration.stepped and declaration.stepper is None:
        place = f"{declaration.name}.{next(iter(declaration.stepped))}"
        refuse("E403", place, "has no stepper that computes it.", "Add @stepper.")
    known = _Known(declaration)
    _check_defaults(declaration, known)
    _check_types(declaration, known)
    _check_times(declaration, known)
    _check_equations(declaration)
    _check_cycles(declaration)
    _check_describing(declaration)
    _check_apart(declaration)


class _Known:
    """What the functions of a class may read before a run begins: its parameters and sizes."""

    def __init__(self, declaration: Declaration) -> None:
        self.parameters = declaration.parameters
        self.structural = {key for key, p in self.parameters.items() if p.structural} | set(declaration.sizes)
        self.everything = set(self.parameters) | set(declaration.sizes)

    def check(self, function: object, place: str, what: str, *, structural: bool = False) -> None:
        """Refuse a function that reads another name. Anything that is no function passes."""
        if not callable(function) or isinstance(function, Variable):
            return
        known = self.structural if structural else self.everything
        for read in arguments(function, place):
            if read not in known:
                kind = "a structural parameter" if structural else "a parameter"
                refuse("E402", place, f"{what} reads '{read}', which is not {kind}.", did_you_mean(read, known))

    def check_first(self, value: object, place: str, words: tuple[str, str]) -> None:
        """Refuse a first value that is a parameter of another class, or a function that reads another name."""
        verb, noun = words
        if isinstance(value, Parameter) and self.parameters.get(value.name) is not value:
            refuse("E402", place, f"{verb} {value!r}, which is not a parameter of this block.")
        self.check(value, place, noun)

    def fix(self, value: object, place: str, what: str) -> None:
        """Check what gives a time, and keep the parameters that it reads from changing during a run."""
        if isinstance(value, Parameter):
            if self.parameters.get(value.name) is not value:
                refuse("E402", place, f"its {what} is {value!r}, which is not a parameter of this block.")
            if value.type not in ("real", "int") or value.shape != () or value.default is None:
                refuse("E405", place, f"its {what} is {value!r}, which is not a number in every instance.")
            value.fixed = True
            return
        self.check(value, place, f"the {what}")
        for read in arguments(value, place) if callable(value) else ():
            if read in self.parameters:
                self.parameters[read].fixed = True


def _check_defaults(declaration: Declaration, known: _Known) -> None:
    """What parameters say of other parameters."""
    for key, parameter in declaration.parameters.items():
        place = f"{declaration.name}.{key}"
        known.check(parameter.default, place, "the default")
        if callable(parameter.default) and key in arguments(parameter.default, place):
            refuse("E404", place, "the default reads the parameter itself.")
        if parameter.excludes and parameter.excludes not in declaration.parameters:
            refuse("E402", place, f"excludes '{parameter.excludes}', which is not a parameter.")
        if (
            not parameter.structural
            and parameter.default is None
            and any(key in equation.reads for equation in declaration.equations)
        ):
            refuse("E405", place, "is optional (None), so only computed defaults may read it.")


def _check_types(declaration: Declaration, known: _Known) -> None:
    """Functions for units, shapes and nominals."""
    for variable in (*declaration.parameters.values(), *declaration.readable.values()):
        place = f"{declaration.name}.{variable.name}"
        for parameter in variable.unit.parameters if isinstance(variable.unit, UnitExpression) else ():
            if known.parameters.get(parameter.name) is not parameter:
                refuse("E402", place, f"its unit is of {parameter!r}, which is not a parameter of this block.")
        known.check(variable.unit, place, "the unit", structural=True)
        if isinstance(variable.ports, Parameter) and known.parameters.get(variable.ports.name) is not variable.ports:
            refuse("E402", place, f"its ports are {variable.ports!r}, which is not a parameter of this block.")
        for size in variable.shape if isinstance(variable.shape, tuple) else (variable.shape,):
            known.check(size, place, "the shape", structural=True)
        if isinstance(variable, State):
            known.check(variable.nominal, place, "the nominal")


def _check_times(declaration: Declaration, known: _Known) -> None:
    """Clocks and delays, what is held before them, and what a program is made from."""
    name = declaration.name
    for equation in declaration.equations:
        for role in equation.roles:
            for value in (role.clock.every, role.clock.offset) if role.clock and role.ticks else ():
                known.fix(value, f"{name}.{equation.name}", "clock")
    if declaration.stepper is not None:
        place = f"{name}.{declaration.stepper.name}"
        for value in (declaration.stepper.clock.every, declaration.stepper.clock.offset):
            known.fix(value, place, "clock")
        for read in declaration.stepper.reads:
            if read not in known.everything:
                cure = did_you_mean(read, known.everything)
                cure = cure or "A stepper is created from parameters; its step() receives the inputs."
                refuse("E402", place, f"reads '{read}', which is not a parameter.", cure)
            if read in known.parameters:
                known.parameters[read].fixed = True
    for history in declaration.histories.values():
        place = f"{name}.{history.name}"
        if declaration.inputs.get(history.of.name) is not history.of:
            refuse("E402", place, f"{history.of!r} belongs to another class.")
        known.fix(history.delay, place, "delay")
        known.check_first(history.before, place, ("begins with", "the value before the start"))
    first: list[Output | Stepped] = [*declaration.outputs.values(), *declaration.stepped.values()]
    for variable in first:
        known.check_first(variable.start, f"{name}.{variable.name}", ("starts at", "the start"))


def _check_equations(declaration: Declaration) -> None:
    """Every name an equation reads exists and may be read there; every variable has what it needs, once."""
    name, readable = declaration.name, declaration.readable
    own = {id(v) for v in (*readable.values(), *declaration.event_times.values())}
    seen: set[tuple[str, int, int]] = set()
    for equation in declaration.equations:
        _check_roles(f"{name}.{equation.name}", equation, own, seen)
        for read in equation.reads:
            _check_read(declaration, readable, equation, read)
    for key, state in declaration.states.items():
        if ("derivative", id(state), id(None)) not in seen and declaration.foreign is None:
            refuse("E403", f"{name}.{key}", "the state has no derivative.", f"Add @{key}.derivative, or use Discrete.")
    for key, algebraic in declaration.algebraics.items():
        if ("residual", id(algebraic), id(None)) not in seen:
            refuse("E403", f"{name}.{key}", "the algebraic variable has no residual.", f"Add @{key}.residual.")
    roles = [role for equation in declaration.equations for role in equation.roles]
    changed = {r.target.name for r in roles if r.target is not None and r.kind in ("derivative", "next", "reset")}
    for key in declaration.discretes:
        if key not in changed:
            refuse("E403", f"{name}.{key}", "the discrete never changes.", "Add .next or a reset, or use Parameter.")
    for requirement in declaration.requirements:
        for read in requirement.equation.reads:
            if read not in declaration.parameters and read not in declaration.sizes:
                refuse("E402", f"{name}.{requirement.equation.name}", f"reads '{read}', which is not a parameter.")
    for key, variable in {**declaration.states, **declaration.discretes}.items():
        ticked = declaration.clock_of(key) is not None
        if variable.output and ticked and not (isinstance(variable, Discrete) and variable.visible):
            cure = 'Add visible="after", or write a sampled output that reads it.'
            refuse("E405", f"{name}.{key}", "a ticked discrete cannot be an output directly.", cure)


def _check_roles(place: str, equation: Equation, own: Collection[int], seen: set[tuple[str, int, int]]) -> None:
    """Refuse roles without sense. own: the variables of the class, by id. seen: the roles so far, each of which may
    appear once; it gets those of this equation."""
    if not equation.roles:
        refuse("E403", place, "this equation has no role.")
    clocks = [role.clock for role in equation.roles if role.clock is not None]
    if any((clock.every, clock.offset) != (clocks[0].every, clocks[0].offset) for clock in clocks):
        refuse("E405", place, "has two clocks.", "Write one equation for each clock.")
    for role in equation.roles:
        for variable in (role.target, role.cause):
            if variable is not None and id(variable) not in own:
                refuse("E402", place, f"{variable!r} belongs to another class.")
        once = (role.kind, id(role.target), id(role.cause))
        if once in seen:
            target = role.target.name if role.target else ""
            refuse("E403", place, f"the {role.kind} of '{target}' appears twice.")
        seen.add(once)


def _check_read(declaration: Declaration, readable: Mapping[str, Variable], equation: Equation, read: str) -> None:
    place = f"{declaration.name}.{equation.name}"
    kinds = {role.kind for role in equation.roles}
    unsampled = {role.kind for role in equation.roles if not role.ticks}
    if read == "t" or read in declaration.sizes:
        return
    if read == "tick":
        if unsampled - {"initial"} or unsampled == kinds:
            refuse("E402", place, "reads 'tick', which only sampled equations can read.", "Add every=, or read t.")
        return
    variable = readable.get(read)
    if variable is None:
        refuse("E402", place, *_unknown_name(declaration, readable, read))
    if "event_time" in kinds and not isinstance(variable, (Parameter, Discrete)):
        refuse("E402", place, f"an event time may read t, parameters and discretes, not {variable!r}.")
    if "event_time" in kinds and isinstance(variable, Parameter):
        variable.fixed = True  # what edges left behind in memory could not follow a change during a run
    if isinstance(variable, Output) and variable.wiring:
        refuse("E402", place, f"reads '{read}', which is a wiring output: equations cannot read it.")
    wires = isinstance(equation.roles[0].target, Output) and equation.roles[0].target.wiring
    if wires and not (isinstance(variable, Input) or (isinstance(variable, Parameter) and variable.structural)):
        refuse("E402", place, f"wiring re-arranges inputs only; it cannot read {variable!r}.")
    if isinstance(variable, Crossing) and variable.start is None and variable in [r.target for r in equation.roles]:
        refuse("E405", place, "reads its own side.", "Set its side at the start: @crossing(start=False).")
    # A local may serve sampled and unsampled equations alike; where it does, it may not read what they see differently.
    is_of_both = kinds == {"local"} and declaration.is_of_ticks(equation.name)
    if not is_of_both and unsampled & {"output", "local", "derivative", "residual", "crossing", "next"}:
        _check_ticked(declaration, place, variable, read)


def _check_ticked(declaration: Declaration, place: str, variable: Variable, read: str) -> None:
    """Refuse that an unsampled equation reads a discrete whose values before and after a tick differ."""
    if isinstance(variable, Discrete) and not variable.visible and declaration.clock_of(read) is not None:
        cure = f'Sample it too (every=), or declare {read} = Discrete(visible="after").'
        refuse("E405", place, f"is unsampled and reads the ticked discrete '{read}'.", cure)


def _unknown_name(declaration: Declaration, readable: Mapping[str, Variable], read: str) -> tuple[str, str]:
    """Return the message and the cure of a name that the class does not have."""
    extra = " It is an event time, which has no value." if read in declaration.event_times else ""
    known = (*readable, "t", "tick")
    names = f"Names: {', '.join(known)}."
    cure = did_you_mean(read, known) or names
    if read == "self":
        cure = f"Remove it: the arguments of an equation are variables of its class. {names}"
    elif cure == names and not extra:
        cure = f"{names} Or declare it: {read} = Parameter(1.0)."
    return f"reads '{read}', which is not a name of this class.{extra}", cure


def _check_cycles(declaration: Declaration) -> None:
    """Locals, outputs and computed defaults must not need themselves."""
    graph: dict[str, tuple[str, ...]] = {}
    for equation in declaration.equations:
        for role in equation.roles:
            if role.kind in ("local", "output") and role.target is not None:
                graph[role.target.name] = equation.reads
    for key, parameter in declaration.parameters.items():
        if callable(parameter.default):
            graph[key] = arguments(parameter.default, key)
    done: set[str] = set()

    def visit(key: str, path: tuple[str, ...]) -> None:
        if key in path:
            cycle = " -> ".join((*path[path.index(key) :], key))
            cure = "" if key in declaration.parameters else "Break the cycle with a State or a Discrete."
            refuse("E404", f"{declaration.name}.{key}", f"needs itself: {cycle}.", cure)
        if key in done or key not in graph:
            return
        for read in graph[key]:
            visit(read, (*path, key))
        done.add(key)

    for key in graph:
        visit(key, ())


def _check_describing(d: Declaration) -> None:
    """Refuse a describing function that does not exist, or of what the block does not have."""
    if not d.describing:
        return
    needs = DESCRIBING.get(d.describing) if isinstance(d.describing, str) else None
    if needs is None:
        refuse("E405", d.name, f"describing= must be one of {', '.join(DESCRIBING)}, not {d.describing!r}.")
    numbers = {key: p for key, p in d.parameters.items() if p.type == "real" and not p.structural}
    cure = f"It describes y for a sine u, by {', '.join(needs)}."
    parts: list[tuple[str, str, Mapping[str, Variable]]] = [("input", "u", d.inputs), ("output", "y", d.outputs)]
    for word, name, group in [*parts, *(("parameter", name, numbers) for name in needs)]:
        if name not in group or group[name].shape != ():
            refuse("E405", d.name, f"describing={d.describing!r} needs the {word} '{name}', one real number.", cure)
    for role in (role for equation in d.equations for role in equation.roles):
        if role.kind == "derivative" or (role.kind == "next" and role.ticks):
            name = role.target.name if role.target is not None else ""
            message = f"describing={d.describing!r} is for a block without dynamics, but '{name}' is dynamic."
            refuse("E405", d.name, message, "Move the dynamics and the ticks into another block.")


def _check_apart(d: Declaration) -> None:
    """Refuse a way of taking a block apart that does not exist, or that needs names which the block does not have."""
    if not d.apart:
        return
    needs = APART.get(d.apart) if isinstance(d.apart, str) else None
    if needs is None:
        refuse("E405", d.name, f"apart= must be one of {', '.join(APART)}, not {d.apart!r}.")
    missing = [name for name in needs if name not in d.parameters and name not in d.inputs]
    if missing:
        refuse("E405", d.name, f"apart={d.apart!r} needs {', '.join(needs)}, but there is no '{missing[0]}'.")
