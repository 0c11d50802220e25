"""Rules of blocks that lead signals: vectors and buses, tags, ports, subsystems, what ends or shows a signal."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

from ..fmi.description import read_description
from .numbers import MOST_ELEMENTS, Raw, Scope, variables
from .rules_math import rule, translated
from .signals import CONSTANT, CONTINUOUS, Attr, Field, Out, Own, joined, outputs_of
from .systems import MOST_BLOCKS, MOST_PORTS, At, Refused, map_system, whole
from .tags import tag_of
from .tree import Block, System

# --- vectors and buses -----------------------------------------------------------------------------------------------


def _inputs_of(at: At, default: str) -> int:
    """Return the number of inputs: of the file if it says one, else as its ports are counted."""
    said = None if at.context.model.value(at.block, "Inputs") is None else at.number_of("Inputs", default)
    return said or at.block.ports.get("in") or at.number_of("Inputs", default) or at.count()


def _gathered(at: At, ports: int, names: list[str] | None = None) -> None:
    """Add a Mux of the elements of all inputs."""
    attrs = [at.attr(port) for port in range(1, ports + 1)]
    total = sum(attr.n for attr in attrs)
    fields, first = [], 0
    for i, attr in enumerate(attrs):
        if names is not None:
            fields.append(Field(names[i], first, attr.n, attr.fields))
        first += attr.n
    words = None
    if names and all(attr.n == 1 for attr in attrs) and len(set(names)) == len(names):
        words = ", ".join(names) if all(re.fullmatch(r"[A-Za-z_]\w*", name) for name in names) else None
    at.add("Mux", size=None if total == 2 else total, names=words)
    k = 1
    for port, attr in enumerate(attrs, 1):
        for element in range(attr.n):
            at.wire(f"{at.name}.u{k}", at.own(port, element))
            k += 1
    at.out(f"{at.name}.y", joined([attr.rate for attr in attrs]), total, is_vector=True, fields=tuple(fields))


@rule("Mux")
def _(at: At) -> None:
    _gathered(at, _inputs_of(at, "4"))


@rule("Concatenate")
def _(at: At) -> None:
    if at.text("Mode", "Vector") != "Vector" and any(at.attr(port).n > 1 for port in range(1, at.count() + 1)):
        raise Refused("its output is a matrix")
    _gathered(at, at.number_of("NumInputs", "2") or at.count(2))


@rule("BusCreator")
def _(at: At) -> None:
    ports = _inputs_of(at, "4")
    given = re.findall(r"'([^']*)'", at.text("Inputs", "4"))
    _gathered(at, ports, [given[i] if i < len(given) else _label(at, i + 1) for i in range(ports)])


def _label(at: At, port: int) -> str:
    """Return the name that a signal has in a bus: of its line, or of the Inport that it comes from."""
    end = at.drawing.drivers.get((at.block.name, str(port)))
    if end is None:
        return f"signal{port}"
    label = at.drawing.labels.get((end.block, end.port))
    if label:
        return label
    block = at.drawing.system.blocks[end.block]
    if block.type == "BusSelector":
        chosen = at.context.model.value(block, "OutputSignals") or ""
        names = chosen.split(",")
        if end.port.isdecimal() and int(end.port) <= len(names):
            return names[int(end.port) - 1].rpartition(".")[2].strip()
    return f"signal{port}"


def _found(at: At, attr: Attr, path: str) -> Field:
    """Return a signal of a bus by its path, "pose.x"."""
    fields, found, first = attr.fields, None, 0
    for name in path.strip().split("."):
        inner = next((one for one in fields if one.name == name), None)
        if inner is None:
            listed = ", ".join(one.name for one in fields) or "none"
            raise Refused(f"its bus has no signal {path.strip()!r}; it has: {listed}")
        first += inner.at
        found, fields = inner, inner.fields
    assert found is not None
    return found._replace(at=first)


@rule("BusSelector")
def _(at: At) -> None:
    attr, paths = at.attr(1), at.text("OutputSignals", "").split(",")
    found = [_found(at, attr, path) for path in paths]
    parts = [(tuple(at.own(1, one.at + i) for i in range(one.n)), one) for one in found]
    if at.is_on("OutputAsBus"):
        elements, fields, first = (), [], 0  # type: tuple[Own, ...], list[Field], int
        for owned, one in parts:
            fields.append(one._replace(at=first))
            elements, first = elements + owned, first + one.n
        at.part.outs["1"] = Out(replace(attr, n=len(elements), fields=tuple(fields)), elements)
        return
    for k, (owned, one) in enumerate(parts, 1):
        at.part.outs[str(k)] = Out(replace(attr, n=one.n, fields=one.fields), owned)


@rule("BusAssignment")
def _(at: At) -> None:
    attr, elements = at.attr(1), [at.own(1, i) for i in range(at.attr(1).n)]
    for k, path in enumerate(at.text("AssignedSignals", "").split(","), 2):
        one = _found(at, attr, path)
        elements[one.at : one.at + one.n] = [at.own(k, i if at.attr(k).n > 1 else 0) for i in range(one.n)]
    at.part.outs["1"] = Out(attr, tuple(elements))


@rule("Demux")
def _(at: At) -> None:
    text, attr = at.text("Outputs", "4"), at.attr(1)
    number = at.number_of("Outputs", "4")
    given = [whole(one, "Outputs", -1, MOST_PORTS) for one in at.scope.raws(text)] if number is None else []
    count = len(given) if number is None else number
    if attr.n < count and attr.rate is not None:
        raise Refused(f"it has {count} outputs for {attr.n} elements")
    if not given:
        size, more = divmod(attr.n, max(count, 1))
        given = [size + (k < more) for k in range(count)] if attr.n >= count else [1] * count
    if sum(one for one in given if one > 0) < attr.n and -1 in given:
        left = attr.n - sum(one for one in given if one > 0)
        given = [left if one == -1 else one for one in given]
    if given == [1] * attr.n and attr.n > 1 and not attr.is_bool:
        at.add("Demux", size=None if attr.n == 2 else attr.n)
        at.wire(f"{at.name}.u", 1, attr.n, is_vector=True)
        for k in range(attr.n):
            at.out(f"{at.name}.y{k + 1}", attr.rate, number=k + 1)
        return
    first = 0
    for k, size in enumerate(given, 1):
        elements = tuple(at.own(1, min(first + i, attr.n - 1)) for i in range(size))
        at.part.outs[str(k)] = Out(replace(attr, n=size, fields=()), elements)
        first += size


@rule("Selector")
def _(at: At) -> None:
    text = at.text("Indices", at.text("IndexParamArray", at.text("Elements", "[1 3]")))
    if at.text("NumberOfDimensions", "1") != "1" or "port" in at.text("IndexOptions", at.text("IndexOptionArray", "")):
        raise Refused("its indices are signals, or of a matrix", "Use MultiportSwitch.")
    text = re.sub(r"^\{(.*)\}$", r"\1", text.strip())
    offset = 0 if at.text("IndexMode", "One-based").startswith("Zero") else 1
    if at.text("IndexOptions", "").startswith("Starting index"):
        first = whole(at.scope.raw(text), "Indices")
        elements = [first - offset + i for i in range(at.whole_number("OutputSizes", "1"))]
    elif at.text("IndexOptions", "") == "Select all":
        elements = [*range(at.attr(1).n)]
    else:
        elements = [whole(one, "Indices") - offset for one in at.scope.raws(text)]
    attr = at.attr(1)
    if attr.rate is not None and not all(0 <= one < attr.n for one in elements):
        raise Refused(f"it selects element {max(elements) + offset} of {attr.n}")
    owned = tuple(at.own(1, min(max(one, 0), attr.n - 1)) for one in elements)
    if len(elements) == 1 or attr.is_bool:
        at.part.outs["1"] = Out(replace(attr, n=len(elements), fields=()), owned)
        return
    at.add("Selector", elements=elements, size=attr.n)
    at.wire(f"{at.name}.u", 1, attr.n, is_vector=True)
    at.out(f"{at.name}.y", attr.rate, len(elements), is_vector=True)


@rule("SignalConversion", "SignalSpecification", "Reshape", "BusToVector", "SignalLabel")
def _(at: At) -> None:
    at.pass_on()


_SILENT = "Goto GotoTagVisibility DocBlock ModelInfo EnablePort TriggerPort ActionPort"


@rule(*_SILENT.split(), "Reference DocBlock", "Reference CMBlock")
def _(at: At) -> None:
    """Nothing of these is in the diagram."""


@rule("From")
def _(at: At) -> None:
    model, blocks = at.context.model, at.drawing.system.blocks.values()
    tag = tag_of(model, at.block)
    found = next((one for one in blocks if one.type == "Goto" and tag_of(model, one) == tag), None)
    if found is None:
        raise Refused(f"its Goto {tag!r} is in another system", "Wire the signal through a port.")
    attr = at.drawing.attr((found.name, "1"))
    at.part.outs["1"] = Out(attr, tuple(Own((found.name, "1"), i) for i in range(attr.n)), Own((found.name, "1")))


@rule("DataTypeConversion", "Reference Data Type Conversion Inherited")
def _(at: At) -> None:
    kind = at.text("OutDataTypeStr", at.text("OutDataTypeMode", "double"))
    if kind == "boolean" and not at.attr(1).is_bool:
        at.each("CompareToConstant", operator="unequal", is_bool=True)
    else:
        at.pass_on()


@rule("InitialCondition")
def _(at: At) -> None:
    at.note("decided", "its value at the start is that of its input", "")
    at.pass_on()


@rule("Width")
def _(at: At) -> None:
    at.add("Constant", value=at.attr(1).n)
    at.out(f"{at.name}.y", CONSTANT)


# --- what ends or shows a signal -------------------------------------------------------------------------------------


@rule(*["Scope", "Display", "Record", "SignalViewerScope", "XYGraph", "WebScope", "SpectrumAnalyzer"],
      "Reference XY scope.", "Reference XYGraph", "Reference Floating Scope")  # fmt: skip
def _(at: At) -> None:
    at.part.log = [(at.block.name, str(port)) for port in range(1, at.count() + 1) if at.is_wired(str(port))]


@rule("ToWorkspace", "ToFile")
def _(at: At) -> None:
    key, default = ("VariableName", "simout") if at.block.type == "ToWorkspace" else ("MatrixName", "ans")
    at.part.outputs = {at.text(key, default): (at.block.name, "1")}


@rule("Terminator")
def _(at: At) -> None:
    """Nothing of it is in the diagram."""


@rule("Stop")
def _(at: At) -> None:
    at.part.stops = [(at.block.name, "1")]


@rule("Assertion", "Reference Checks_DGap", "Reference Checks_DMin", "Reference Checks_DMax", "Reference Checks_DRange",
      "Reference Checks_SMin", "Reference Checks_SMax", "Reference Checks_SRange", "Reference Checks_SGap",
      "Reference Checks_Gradient", "Reference Checks_Resolution")  # fmt: skip
def _(at: At) -> None:
    at.note("decided", "it only checks a signal, and is left out", "Write a measure, or stop_when.")


_SHOWN = """
CheckBoxBlock CircularGaugeBlock CallbackButton ComboBoxBlock CustomCallbackButton DashboardScope DisplayBlock EditField
KnobBlock LampBlock LinearGaugeBlock MultiStateImageBlock PushButtonBlock QuarterGaugeBlock RadioButtonGroupBlock
RockerSwitchBlock RotarySwitchBlock SemiCircularGaugeBlock SliderBlock SliderSwitchBlock ToggleSwitchBlock
"""


@rule(*_SHOWN.split())
def _(at: At) -> None:
    at.note("decided", "it only shows or sets a value, and is left out", "Use the live page.")


# --- ports and subsystems --------------------------------------------------------------------------------------------


@rule("Inport")
def _(at: At) -> None:
    attr = at.drawing.inputs.get(at.text("Port", "1"))
    if attr is None:
        size = [whole(one, "PortDimensions", -1, MOST_ELEMENTS) for one in at.raws("PortDimensions", "-1")]
        n = math.prod(size)
        if n > MOST_ELEMENTS or (n > 1 and n not in size):
            raise Refused(f"its dimensions are {at.text('PortDimensions')!r}", "Give it the size of a vector.")
        attr = Attr(max(n, 1), rate=at.own_rate() or CONTINUOUS)
    at.part.outs["1"] = outputs_of(at.name, attr)


@rule("Outport")
def _(at: At) -> None:
    """Its output is written with the wires of the system."""


_STRANGE = {
    "ForIterator": "it runs in a loop", "WhileIterator": "it runs in a loop", "ForEach": "it is a For Each Subsystem",
    "ResetPort": "it can be reset", "StateControl": "it has a state control",
}  # fmt: skip


@rule("SubSystem")
def _(at: At) -> None:
    block = at.block
    kind = block.values.get("SFBlockType", "NONE")
    if kind != "NONE":
        raise Refused(f"a {kind}", "Write its text as a block of your own.")
    if block.system is None:
        raise Refused("a subsystem without content")
    if block.values.get("Variant", "off") == "on":
        raise Refused("it has variants, of which one is active", "Keep the active one in its place.")
    mask, scope = block.mask, Scope(at.scope.known, base=at.scope.workspace)
    if mask:
        own = {name: block.values.get(name, text) for name, text in mask.parameters.items()}
        scope = at.scope.inner(own, mask.initialization)
        if re.search(r"\b(set_param|(add|delete|replace)_(block|line))\b", mask.initialization):
            what = "the code of its mask changes blocks, and is not run"
            at.note("unknown", what, "Look at it there, and save the result.")
    _inside(at, at.context, block.system, scope)


@rule("ModelReference")
def _(at: At) -> None:
    name = at.text("ModelName", at.text("ModelNameDialog", at.text("ModelFile", "")))
    name = re.sub(r"\.(slx|mdl)p?$", "", name)
    model = at.context.open_model(name)
    if model is None:
        raise Refused(f"there is no {name}.slx and no {name}.mdl beside the model", "Put the file there.")
    if at.text("ParameterArgumentValues").strip(" ,"):
        raise Refused("it gives values to the model's arguments", "Set them in the workspace of that model.")
    known, _ = variables(model, at.scope.workspace)  # masks around it are not seen there
    _inside(at, at.context.inside(model, name), model.system, Scope(known))


@rule("FMU")
def _(at: At) -> None:
    """Add an FMU that lies beside the model; its ports are in the order of its description."""
    name = at.text("FMUName")
    path = at.context.folder / name
    if not re.fullmatch(r"[\w.-]+\.fmu", name) or not path.is_file():
        raise Refused(f"there is no {name} beside the model", "Put the file there.")
    ports = {"input": [], "output": []}  # type: dict[str, list[str]]
    for variable in read_description(path).variables:
        if variable.causality in ports:
            ports[variable.causality].append(variable.name)
    at.part.blocks[at.name] = {"fmu": name}
    at.note("decided", "its parameters have the values of the FMU", "Set them in the diagram.")
    for k, port in enumerate(ports["input"], 1):
        at.wire(f"{at.name}.{port}", k)
    for k, port in enumerate(ports["output"], 1):
        at.out(f"{at.name}.{port}", CONTINUOUS, number=k)


_OF_SIMULINK = re.compile(
    r"simulink|cstblocks|sm_lib|fl_lib|nesl_|dsp|aero|vr|power|sps_|mech|hydro|robot|eml_lib|sflib|fixpt"
)
"""Names of MathWorks' own libraries, which nobody has beside a model."""


def linked(at: At) -> None:
    """Map a link into a library whose file lies beside the model."""
    name, _, path = at.text("SourceBlock", "").partition("/")
    library = at.context.open_model(name)
    if library is None and _OF_SIMULINK.match(name):
        raise Refused(
            f"no equal of {path.rpartition('/')[2].replace(chr(10), ' ')} here", "Write it as a block of your own."
        )
    if library is None:
        raise Refused(f"a link to {at.text('SourceBlock').replace(chr(10), ' ')!r}, which is not here",
                      f"Put {name}.slx beside the model, or break the link there.")  # fmt: skip
    inside: System | None = library.system
    found: Block | None = None
    for part in re.split(r"(?<!/)/(?!/)", path):
        found = inside.blocks.get(part.replace("//", "/")) if inside else None
        inside = found.system if found else None
    if found is None:
        raise Refused(f"the library {name} has no block {path.replace(chr(10), ' ')!r}")
    values = {key: value for key, value in at.block.values.items() if key not in ("SourceBlock", "SourceType")}
    one = replace(
        found,
        name=at.block.name,
        path=at.block.path,
        values={**found.values, **values},
        ports=at.block.ports or found.ports,
    )
    inner = At(at.drawing, one)
    inner.context, inner.part = at.context.inside(library, at.text("SourceBlock")), at.part
    function = at.context.rule_of(one)
    if function is None:
        raise Refused(f"no equal of {found.type} here")
    function(inner)


def _inside(at: At, context: Any, system: System, scope: Scope) -> None:
    """Add a system as a subdiagram."""
    for block in system.blocks.values():
        if block.type in _STRANGE:
            raise Refused(_STRANGE[block.type], "Write it as a block of your own.")
    shown = {name: block for name, block in system.blocks.items() if block.values.get("Commented", "off") == "off"}
    inports = {block.values.get("Port", "1"): name for name, block in shown.items() if block.type == "Inport"}
    for port in inports:
        if not re.fullmatch(r"\d{1,4}", port, re.ASCII):
            raise Refused(f"the number of its port is {port[:20]!r}")
    attrs = {port: at.attr(port) for port in inports}
    rate = at.own_rate("SystemSampleTime") if at.is_on("TreatAsAtomicUnit") else None
    held: list[str] = []
    if rate is not None and rate.is_sampled:
        context = replace(context, fallback=Raw(rate.json, rate.period))
        held = [port for port in inports if attrs[port].rate not in (rate, CONSTANT)]
        attrs = {port: replace(attr, rate=rate) for port, attr in attrs.items()}
    controls = [block for block in system.blocks.values() if block.type in ("EnablePort", "TriggerPort", "ActionPort")]
    if any(at.context.model.value(block, "ShowOutputPort") == "on" for block in controls):
        raise Refused("its enable or trigger signal is read inside", "Bring it in by an Inport.")
    if len(controls) > 1:
        raise Refused("it is enabled and triggered", "Put a triggered subdiagram into an enabled one.")
    key = (at.block.path, tuple(sorted(attrs.items())), context.fallback, tuple(sorted(scope.own.items())), id(system),
           context.opened, scope.masked())  # fmt: skip
    mapped = context.kept.get(key)
    if mapped is None:
        at.context.left[0] -= len(system.blocks) + 1
        if at.context.left[0] > 0:
            mapped = context.kept[key] = map_system(context, system, scope, attrs)
    if mapped is None or mapped.size > MOST_BLOCKS:
        raise Refused("with all that it refers to, it has too many blocks", "Import its parts.")
    at.part.is_late |= mapped.is_late
    entry: dict[str, Any] = {"diagram": mapped.body}
    given = {name: mapped.scope.handed(name, at.scope) for name in mapped.used}
    given = {name: value for name, value in given.items() if value is not None}
    if given:
        entry["parameters"] = given
    at.part.blocks[at.name] = entry
    for control in controls:
        _control(at, entry, control, system)
    for port, name in inports.items():
        attr, arriving = attrs[port], at.own(port)  # type: Attr, Own | str
        if rate is not None and port in held:
            hold = at.add(
                "ZeroOrderHold", f"_{mapped.names[name]}", attr.n, period=rate.json, offset=rate.offset or None
            )
            at.wire(f"{hold}.u", arriving, attr.n)
            arriving = f"{hold}.y"
        at.wire(f"{at.name}.{mapped.names[name]}", arriving, attr.n, is_bool=attr.is_bool, is_vector=attr.n > 1)
    for name, block in shown.items():
        if block.type == "Outport" and block.values.get("Port", "1") in mapped.outs:
            number = block.values.get("Port", "1")
            attr = mapped.outs[number]
            at.part.outs[number] = outputs_of(f"{at.name}.{mapped.names[name]}", attr)
    at.part.inner = mapped
    at.part.ports = {mapped.names[name]: port for port, name in inports.items()}
    # A Scope inside may show an input as it arrives.
    passed = [re.split(r"\W", one, maxsplit=1)[0] for one in mapped.log if "." not in one]
    at.part.log += [(at.block.name, at.part.ports[one]) for one in passed if one in at.part.ports]


def _control(at: At, entry: dict[str, Any], control: Block, system: System) -> None:
    def said(block: Block, key: str, default: str) -> str:
        return at.context.model.value(block, key) or default

    outports = [block for block in system.blocks.values() if block.type == "Outport"]
    if control.type == "TriggerPort":
        way = said(control, "TriggerType", "rising")
        if way not in ("rising", "falling", "either"):
            raise Refused(f"it is triggered by {way}", "Use an enabled or triggered subdiagram.")
        if any(block.type in _SAMPLED and said(block, "SampleTime", "-1").strip() == "-1" for block in system.walk()):
            raise Refused("it holds sampled blocks that tick with its trigger", "Use ResettableIntegrator, or Counter.")
        entry["trigger"] = {"direction": {"rising": "up", "falling": "down", "either": "both"}[way]}
        at.wire(f"{at.name}.trigger", at.own("trigger"))
    else:
        key = "InitializeStates" if control.type == "ActionPort" else "StatesWhenEnabling"
        kept = {said(block, "OutputWhenDisabled", "held") for block in outports}
        if len(kept) > 1:
            at.note("decided", "all its outputs are held while it is off; there some are reset", "")
        outputs, states = kept.pop() if len(kept) == 1 else "held", said(control, key, "held")
        if {outputs, states} - {"held", "reset"}:
            raise Refused(f"what happens while it is off is {outputs!r}, {states!r}")
        entry["enable"] = {"states": states, "outputs": outputs}
        port = "ifaction" if control.type == "ActionPort" else "enable"
        if at.attr(port).is_bool:
            at.wire(f"{at.name}.enable", at.own(port), is_bool=True)
        else:
            name = at.add("CompareToConstant", "_on", operator=">")
            at.wire(f"{name}.u", at.own(port))
            at.wire(f"{at.name}.enable", f"{name}.y", is_bool=True)
    if any(said(block, "InitialOutput", "[]") not in ("[]", "0") for block in outports) or control.type != "ActionPort":
        what = "before it runs first, its outputs are those at the start; there they are its initial outputs"
        at.note("decided", what, "")


_SAMPLED = frozenset(
    [
        "UnitDelay",
        "Delay",
        "DiscreteIntegrator",
        "DiscreteTransferFcn",
        "DiscreteFilter",
        "DiscreteStateSpace",
        "DiscreteFir",
        "Memory",
    ]
)


@rule("If", "SwitchCase")
def _(at: At) -> None:
    conditions = _conditions(at)
    before = ""
    for k, (text, elements) in enumerate(conditions, 1):
        if not text and not before:
            raise Refused("it has no condition")
        own = f"not ({before})" if not text else f"({text}) and not ({before})" if before else text
        name = at.add("Expression", f"_{k}" if k > 1 else "", expression=own)
        before = f"{before} or ({text})" if before else f"({text})"
        for number in range(1, max([int(one) for one in re.findall(r"\bu(\d+)", own)], default=0) + 1):
            at.wire(f"{name}.u{number}", elements[number - 1])
        at.out(f"{name}.y", joined([at.attr(one).rate for one in elements]) or CONTINUOUS, number=k, is_bool=True)


def _conditions(at: At) -> list[tuple[str, list[int]]]:
    """Return the conditions of the outputs over u1, u2, ...; the last may be "", for all else."""
    if at.block.type == "If":
        texts = [
            at.text("IfExpression", "u1 > 0"),
            *[one for one in at.text("ElseIfExpressions").split(",") if one.strip()],
        ]
        ports = [*range(1, at.count() + 1)]
        found = []
        for text in texts:
            written, elements, names, truths, is_bool = translated(text)
            if names or truths or not is_bool:
                raise Refused(f"its condition {text.strip()[:60]!r} is no condition of its inputs alone")
            for k in range(len(elements), 0, -1):  # back to the numbers of its inputs
                written = re.sub(rf"\bu{k}\b", f"v{elements[k - 1]}", written)
            found.append((written.replace("v", "u"), ports))
        return found + ([("", ports)] if at.is_on("ShowElse", "on") else [])
    cases = re.findall(r"\[[^\]]*\]|[-\w.]+", at.text("CaseConditions", "{1}").strip().strip("{}"))
    found = []
    for case in cases:
        values = [whole(one, "CaseConditions", -(2**31), 2**31) for one in at.scope.raws(case)]
        found.append((" or ".join(f"u1 == {value}" for value in values), [1]))
    return found + ([("", [1])] if at.is_on("ShowDefaultCase", "on") else [])


@rule("Merge")
def _(at: At) -> None:
    ports = at.count(2)
    sources: list[Own] = []
    for port in range(1, ports + 1):
        end = at.drawing.drivers.get((at.block.name, str(port)))
        control = None if end is None else (end.block, "ifaction")
        if control is None or control not in at.drawing.drivers:
            raise Refused("its inputs are no action subsystems", "Use Switch.")
        sources.append(Own(control))
    deciding = {at.drawing.drivers[source.reading] for source in sources}
    first = at.drawing.system.blocks[next(iter(deciding)).block]
    rest = {"If": "ShowElse", "SwitchCase": "ShowDefaultCase"}.get(first.type, "")
    has_rest = rest and (at.context.model.value(first, rest) or "on") == "on"
    is_one = {end.block for end in deciding} == {first.name}
    if not has_rest or not is_one or len(deciding) < len(_conditions(At(at.drawing, first))):
        raise Refused(
            "there are times at which none of its inputs runs, and it holds the last of them",
            "Give the If an else, or write it as a block of your own.",
        )
    n = at.width(ports=range(1, ports + 1))
    rate = at.inherited(range(1, ports + 1)) or CONTINUOUS
    after: Any = at.own(ports)
    for k in range(ports - 1, 0, -1):
        name = at.add("Switch", "" if k == 1 else f"_{k}", n)
        at.wire(f"{name}.u1", at.own(k), n)
        at.wire(f"{name}.u2", after, n)
        at.wire(f"{name}.control", sources[k - 1], is_bool=True)
        after = f"{name}.y"
    at.out(after, rate, n)
