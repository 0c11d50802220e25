"""Models of Simulink: two drawn by hand, random ones, and the four forms of their files.

A drawn model is a tree of `blocks.simulink`. The writers follow files that Simulink saved, and share no code with the
reader.
"""

from __future__ import annotations

import base64
import re
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from hypothesis import strategies as st

from blocks.simulink import Annotation, Block, End, Line, Mask, Model, System
from blocks.simulink.tree import Node

PORTS = ("in", "out", "enable", "trigger", "state", "lconn", "rconn", "ifaction", "reset")
_BARE = frozenset({
    "BlockType", "Commented", "DstPort", "Enabled", "Location", "Open", "Points", "Ports", "Position", "ShowName",
    "SrcPort", "Version", "ZOrder", "$ObjectID", "Dimension", "id", "machine", "chart", "isEML",
})  # fmt: skip
_OF_THE_LINK = ("Commented", "Position", "SourceBlock", "SourceType", "ZOrder")


# --- drawing ----------------------------------------------------------------------------------------------------------


def block(
    kind: str,
    name: str,
    sid: int | str,
    values: Mapping[str, str] | None = None,
    ports: Mapping[str, int] | None = None,
    *,
    inside: System | None = None,
    mask: Mask | None = None,
    script: str = "",
) -> Block:
    """Return a block that lies nowhere yet."""
    values = values or {}
    callbacks = {key: value for key, value in values.items() if key.endswith("Fcn")}
    return Block(kind, name, str(sid), (name,), values, ports or {}, inside, mask, script, callbacks)


def line(source: tuple[str, str] | None, *targets: tuple[str, str], name: str = "", open_ends: int = 0) -> Line:
    return Line(End(*source) if source else None, tuple(End(*target) for target in targets), name, open_ends)


def system(blocks: Iterable[Block], lines: Sequence[Line] = (), notes: Sequence[Annotation] = ()) -> System:
    return System({one.name: one for one in blocks}, [*lines], [*notes], {})


def model(name: str, inside: System, kind: str = "Model", **more: Mapping[str, Any]) -> Model:
    """Return a model, whose blocks get their paths. more: its settings, defaults and callbacks."""
    given: dict[str, Any] = {"settings": {}, "defaults": {}, "callbacks": {}, **more}
    return Model(name, Path(), kind, system=_placed(inside, ()), **given)


def _placed(inside: System, path: tuple[str, ...]) -> System:
    blocks = {
        one.name: replace(one, path=(*path, one.name), system=one.system and _placed(one.system, (*path, one.name)))
        for one in inside.blocks.values()
    }
    return replace(inside, blocks=blocks)


def bare(read: Model) -> Model:
    """Return a model without what its form adds: places in the file, and the sizes of windows."""
    return replace(read, path=Path(), system=_bare(read.system))


def _bare(inside: System) -> System:
    blocks = {
        name: replace(
            one,
            values={key: value for key, value in one.values.items() if key != "Ports"},
            system=one.system and _bare(one.system),
            file="",
            line=0,
        )
        for name, one in inside.blocks.items()
    }
    return System(blocks, [replace(one, file="", line=0) for one in inside.lines], [*inside.annotations], {})


# --- two models -------------------------------------------------------------------------------------------------------


def dc_motor() -> Model:
    """Return a speed loop: a masked motor inside, a link to a library with a mended value, lines that end nowhere."""
    motor = system(
        [
            block("Inport", "U", 11, {"Port": "1"}, {"out": 1}),
            block("Inport", "load", 12, {"Port": "2"}, {"out": 1}),
            block("Sum", "U - E", 13, {"Inputs": "|+-", "IconShape": "round"}, {"in": 2, "out": 1}),
            block("TransferFcn", "1/(L s + R)", 14, {"Numerator": "[1]", "Denominator": "[L R]"}, {"in": 1, "out": 1}),
            block("Gain", "k\nof the torque", 15, {"Gain": "k"}, {"in": 1, "out": 1}),
            block("Sum", "T", 16, {"Inputs": "+-"}, {"in": 2, "out": 1}),
            block("Integrator", "1/(J s)", 17, {"InitialCondition": "w_0/J"}, {"in": 1, "out": 1}),
            block("Gain", 'k of the "EMF"', 18, {"Gain": "k", "Position": "[300, 120, 330, 150]"}),
            block("Outport", "w", 19, {"Port": "1"}, {"in": 1}),
        ],
        [
            line(("U", "1"), ("U - E", "1")),
            line(("load", "1"), ("T", "2"), name="T_load"),
            line(("U - E", "1"), ("1/(L s + R)", "1")),
            line(("1/(L s + R)", "1"), ("k\nof the torque", "1"), name="i"),
            line(("k\nof the torque", "1"), ("T", "1")),
            line(("T", "1"), ("1/(J s)", "1")),
            line(("1/(J s)", "1"), ("w", "1"), ('k of the "EMF"', "1")),
            line(('k of the "EMF"', "1"), ("U - E", "2")),
        ],
    )
    mask = Mask("DC motor", {"R": "0.5", "L": "2e-3", "k": "k_m", "w_0": ""}, "J = 1e-4; % kg m^2\nif R<0; R = 0; end")
    pid = {
        "SourceBlock": "simulink/Continuous/PID Controller",
        "SourceType": "PID 1dof",
        "Position": "[150, 40, 190, 80]",
        "P": "0.1",
        "I": "2*pi",
        "Controller": "PI",
    }
    outside = system(
        [
            block("Step", "Set point\n[rad/s]", 1, {"Time": "0.1", "After": "100"}, {"out": 1}),
            block("Sum", "e", 2, {"Inputs": "|+-"}, {"in": 2, "out": 1}),
            block("Reference", "PI / Regler", 3, pid, {"in": 1, "out": 1}),
            block("Saturate", "±24 V", 4, {"UpperLimit": "U_max", "LowerLimit": "-U_max"}, {"in": 1, "out": 1}),
            block("SubSystem", "Motor", 5, {"OpenFcn": "disp('motor')"}, {"in": 2, "out": 1}, inside=motor, mask=mask),
            block("Scope", "Speed", 6, {"Commented": "on"}, {"in": 1}),
            block("Outport", "ω", 7, {}, {"in": 1}),
            block("Constant", "spare", 8, {"Value": "[1 2; 3, 4]'"}, {"out": 1}),
        ],
        [
            line(("Set point\n[rad/s]", "1"), ("e", "1")),
            line(("e", "1"), ("PI / Regler", "1")),
            line(("PI / Regler", "1"), ("±24 V", "1")),
            line(("±24 V", "1"), ("Motor", "1")),
            line(("Motor", "1"), ("e", "2"), ("Speed", "1"), ("ω", "1"), name="<speed & more>", open_ends=1),
            line(None, ("Motor", "2")),
            line(("spare", "1"), open_ends=1),
        ],
        [Annotation('Drehzahl in 1/s: 20 °C,\n"kalt"', "[10, 200]")],
    )
    return model(
        "dc_motor",
        outside,
        settings={"StartTime": "0.0", "StopTime": "5*T", "SolverName": "ode15s", "MaxStep": "auto", "RelTol": "1e-6"},
        defaults={"Gain": {"Gain": "1"}, "Integrator": {"InitialCondition": "0", "LimitOutput": "off"}},
        callbacks={"InitFcn": "T = 1;\nU_max = 24;\t% V\nk_m = 0.02;", "CloseFcn": "clear('T')"},
    )


COMFORT = """\
function u = comfort(T, soll)
%#codegen
if T < soll - 0.5  % "zu kalt"
    u = 1;
else
    u = 0;
end
"""


def house() -> Model:
    """Return a house: systems three deep that are enabled, triggered or chosen by an If, and a MATLAB Function."""
    room = system(
        [
            block("Inport", "heat", 21, {}, {"out": 1}),
            block("EnablePort", "Enable", 22, {"StatesWhenEnabling": "reset"}),
            block("UnitDelay", "T", 23, {"SampleTime": "60", "InitialCondition": "15"}, {"in": 1, "out": 1}),
            block("Outport", "out", 24, {}, {"in": 1}),
        ],
        [line(("heat", "1"), ("T", "1")), line(("T", "1"), ("out", "1"))],
    )
    function = system([block("Demux", " Demux ", "32::1", {}, {"in": 1, "out": 1})])
    kitchen = system(
        [
            block("Inport", "In1", 31, {}, {"out": 1}),
            block(
                "SubSystem",
                "Comfort",
                32,
                {"SFBlockType": "MATLAB Function"},
                {"in": 2, "out": 1},
                inside=function,
                script=COMFORT,
            ),
            block("SubSystem", "Wände\nund Dach", 33, {}, {"in": 1, "out": 1, "enable": 1}, inside=room),
            block("Constant", "20 °C", 34, {"Value": "20"}, {"out": 1}),
            block("Outport", "Out1", 35, {}, {"in": 1}),
        ],
        [
            line(("In1", "1"), ("Comfort", "1")),
            line(("20 °C", "1"), ("Comfort", "2"), ("Wände\nund Dach", "1")),
            line(("Comfort", "1"), ("Wände\nund Dach", "enable")),
            line(("Wände\nund Dach", "1"), ("Out1", "1")),
        ],
    )
    action = system([block("ActionPort", "Action Port", 41, {"InitializeStates": "held"})])
    outside = system(
        [
            block("Sin", "weather", 1, {"Bias": "5", "Frequency": "2*pi/86400"}, {"out": 1}),
            block("SubSystem", "Küche", 2, {}, {"in": 1, "out": 1}, inside=kitchen),
            block("If", "If", 3, {"IfExpression": "u1 > 0", "ShowElse": "on"}, {"in": 1, "out": 2}),
            block("SubSystem", "Sommer, Herbst", 4, {}, {"ifaction": 1}, inside=action),
            block("SubSystem", "counter", 5, {}, {"trigger": 1}, inside=system([block("TriggerPort", "Trigger", 51)])),
            block("Terminator", "\\", 6, {}, {"in": 1}),
        ],
        [
            line(("weather", "1"), ("Küche", "1"), ("If", "1")),
            line(("Küche", "1"), ("counter", "trigger")),
            line(("If", "1"), ("Sommer, Herbst", "ifaction")),
            line(("If", "2"), ("\\", "1")),
            line(None, open_ends=2),
        ],
        [Annotation("Haus", ""), Annotation("Ein Tag", "[0, 0, 10, 10]")],
    )
    settings = {"StopTime": "86400", "SolverName": "FixedStepDiscrete", "FixedStep": "60"}
    return model("house_1", outside, settings=settings, callbacks={"PreLoadFcn": "day = 86400;"})


# --- random models ----------------------------------------------------------------------------------------------------

_letters = st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"], exclude_characters="\ufffe\uffff")
_texts = st.text(st.one_of(st.sampled_from("\n\t\r \"'\\/{}[]#<>&%|=:,1a"), _letters), max_size=12)
_names = st.text(st.one_of(st.sampled_from('\n\t "\\/{}[]#<&1a'), _letters), min_size=1, max_size=8)
_values = st.dictionaries(st.sampled_from(["Gain", "Value", "Inputs", "Description", "SampleTime"]), _texts, max_size=3)


@st.composite
def systems(draw: st.DrawFn, depth: int = 2, sids: list[int] | None = None) -> System:
    sids = sids if sids is not None else [0]
    blocks = []
    for name in draw(st.lists(_names, max_size=4, unique=True)):
        sids[0] += 1
        ports = draw(st.dictionaries(st.sampled_from(PORTS), st.integers(1, 12), max_size=3))
        inner = None
        sid = sids[0]
        if depth and draw(st.integers(0, 2)) == 0:
            inner = draw(systems(depth - 1, sids))
        mask = draw(st.none() | st.builds(Mask, _texts, st.dictionaries(st.just("K") | st.just("T"), _texts), _texts))
        kind = "SubSystem" if inner else draw(st.sampled_from(["Gain", "Sum", "Reference", "S-Function"]))
        blocks.append(block(kind, name, sid, draw(_values), ports, inside=inner, mask=mask))
    lines = []
    if blocks:
        named = st.sampled_from([one.name for one in blocks])
        outputs = st.builds(End, named, st.integers(1, 20).map(str))
        inputs = st.builds(End, named, st.integers(1, 20).map(str) | st.sampled_from(["enable", "trigger", "ifaction"]))
        for targets in draw(st.lists(st.lists(inputs, max_size=5), max_size=3)):
            left = draw(st.integers(0 if targets else 1, 2))
            lines.append(Line(draw(st.none() | outputs), tuple(targets), draw(_texts), left))
    return system(blocks, lines, draw(st.lists(st.builds(Annotation, _texts, st.just("[1, 2]")), max_size=2)))


def models() -> st.SearchStrategy[Model]:
    return st.builds(lambda inside: model("some", inside), systems())


# --- lines, as both formats have them ---------------------------------------------------------------------------------


def _branches(node: Node, ends: Sequence[End | None], written: Callable[[End], dict[str, str]]) -> None:
    """Give a line its ends: one by itself, several as branches, of which the first ones branch once more."""
    if len(ends) == 1:
        node.values |= {"Points": "[20, 0; 0, 15]"} | (written(ends[0]) if ends[0] else {})
        return
    inner = (len(ends) + 1) // 2 if len(ends) > 3 else 1
    for part in (ends[:inner], *([end] for end in ends[inner:])):
        node.children.append(below := Node("Branch"))
        _branches(below, part, written)


def _ends(drawn: Line) -> list[End | None]:
    return [*drawn.targets, *[None] * drawn.open_ends]


# --- the text format --------------------------------------------------------------------------------------------------


def write_mdl(drawn: Model, folder: Path, encoding: str = "utf-8") -> Path:
    """Write the text format of older releases."""
    path = folder / f"{drawn.name}.mdl"
    path.write_bytes(mdl_text(drawn, encoding))
    return path


def mdl_text(drawn: Model, encoding: str = "utf-8") -> bytes:
    solver = Node("Simulink.SolverCC", {"$ObjectID": "2", "Version": "1.11.0", **drawn.settings})
    components = Node("Array", {"Type": "Handle", "Dimension": "1", "PropName": "Components"}, [solver])
    configuration = Node("Simulink.ConfigSet", {"$ObjectID": "1", "Version": "1.11.0", "Name": "a"}, [components])
    sets = Node("Array", {"Type": "Handle", "Dimension": "1", "PropName": "ConfigurationSets"}, [configuration])
    active = Node("Simulink.ConfigSet", {"$PropName": "ActiveConfigurationSet", "$ObjectID": "1"})
    defaults = [Node("Block", {"BlockType": kind, **values}) for kind, values in drawn.defaults.items()]
    top = Node(
        drawn.kind,
        {"Name": drawn.name, "Version": "8.1", "SavedCharacterEncoding": encoding, **drawn.callbacks},
        [
            Node("GraphicalInterface", {"NumRootInports": "0"}),
            *([sets, active] if drawn.settings else []),
            Node("BlockDefaults", {"ForegroundColor": "black"}),
            *([Node("BlockParameterDefaults", {}, defaults)] if defaults else []),
            _mdl_system(drawn.system, drawn.name),
        ],
    )
    text = [*_mdl_lines(top, 0)]
    charts = [one for one in drawn.system.walk() if one.script]
    if charts:
        text += ["# Finite State Machines", *_mdl_lines(_mdl_charts(drawn, charts), 0)]
    return "\n".join(text).encode(encoding) + b"\n"


def _mdl_charts(drawn: Model, charts: list[Block]) -> Node:
    below = [Node("machine", {"id": "1", "name": drawn.name})]
    for k, one in enumerate(charts):
        name, of = "/".join(one.path), {"chart": str(10 * k + 2)}
        below += [
            Node("chart", {"id": of["chart"], "machine": "1", "name": f"{drawn.name}/{name}", "type": "EML_CHART"}),
            Node(
                "state",
                {"id": str(10 * k + 3), "labelString": "eML_blk_kernel()", **of},
                [Node("eml", {"isEML": "1", "script": one.script})],
            ),
            Node("instance", {"id": str(10 * k + 4), "machine": "1", "name": name, **of}),
        ]
    return Node("Stateflow", {}, below)


def _mdl_system(inside: System, name: str) -> Node:
    def source(end: End) -> dict[str, str]:
        return {"SrcBlock": end.block, "SrcPort": end.port}

    def target(end: End) -> dict[str, str]:
        return {"DstBlock": end.block, "DstPort": end.port}

    below = [_mdl_block(one) for one in inside.blocks.values()]
    for one in inside.lines:
        node = Node("Line", ({"Name": one.name, "Labels": "[0, 0]"} if one.name else {}))
        node.values |= source(one.source) if one.source else {}
        _branches(node, _ends(one), target)
        below.append(node)
    below += [Node("Annotation", {"Name": note.text, "Position": note.position}) for note in inside.annotations]
    return Node("System", {"Name": name, "Location": "[2, 78, 1022, 740]", "Open": "on"}, below)


def _mdl_block(one: Block) -> Node:
    node = Node("Block", {"BlockType": one.type, "Name": one.name, "SID": one.sid})
    if one.ports:
        node.values["Ports"] = _port_list(one.ports)
    node.values |= one.values
    if one.mask is not None:
        node.children.append(_mdl_mask(one.mask))
    if one.system is not None:
        node.children.append(_mdl_system(one.system, one.name))
    return node


def _mdl_mask(mask: Mask) -> Node:
    node = Node("Object", {"$PropName": "MaskObject", "$ObjectID": "7", "$ClassName": "Simulink.Mask"})
    node.values |= {"Type": mask.type, "Initialization": mask.initialization, "Display": 'disp("{")'}
    below = [Node("Object", {"Name": key, "Prompt": "?", "Value": value}) for key, value in mask.parameters.items()]
    if len(below) == 1:
        below[0].values |= {"$PropName": "Parameters", "$ClassName": "Simulink.MaskParameter"}
        node.children = below
    elif below:
        array = {"Type": "Simulink.MaskParameter", "Dimension": str(len(below)), "PropName": "Parameters"}
        node.children = [Node("Array", array, below)]
    return node


def _port_list(ports: Mapping[str, int]) -> str:
    counts = [ports.get(key, 0) for key in PORTS]
    while counts and not counts[-1]:
        counts.pop()
    return f"[{', '.join(map(str, counts))}]"


def _mdl_lines(node: Node, depth: int) -> Iterable[str]:
    yield f"{'  ' * depth}{node.kind} {{"
    for key, value in node.values.items():
        yield f"{'  ' * (depth + 1)}{key}\t\t{value if key in _BARE and value else _quoted(value)}"
    for child in node.children:
        yield from _mdl_lines(child, depth + 1)
    yield f"{'  ' * depth}}}"


def _quoted(text: str) -> str:
    """Return a text in quotation marks; a long one goes on in the next line."""
    for letter, written in (("\\", "\\\\"), ('"', '\\"'), ("\n", "\\n"), ("\t", "\\t")):
        text = text.replace(letter, written)
    return "\n".join(f'"{piece}"' for piece in re.findall(r"(?s)(?:\\.|[^\\]){1,40}", text) or [""])


# --- the XML of packages ----------------------------------------------------------------------------------------------


def write_inline(drawn: Model, folder: Path) -> Path:
    """Write the package of earlier releases, whose block diagram is one part."""
    return packed(folder / f"{drawn.name}.slx", parts_of(drawn, split=False))


def write_split(drawn: Model, folder: Path) -> Path:
    """Write the package of later releases, with a part for each system, set of settings, and chart."""
    return packed(folder / f"{drawn.name}.slx", parts_of(drawn, split=True))


def write_text_package(drawn: Model, folder: Path) -> Path:
    """Write the .mdl of later releases: the parts one after the other."""
    path = folder / f"{drawn.name}.mdl"
    path.write_bytes(text_package(parts_of(drawn, split=True)))
    return path


FORMS: Mapping[str, Callable[[Model, Path], Path]] = {
    "mdl": write_mdl,
    "inline": write_inline,
    "split": write_split,
    "text package": write_text_package,
}


def packed(path: Path, parts: Mapping[str, bytes]) -> Path:
    """Write a ZIP of these parts."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as package:
        for name, part in parts.items():
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            package.writestr(entry, part)
    return path


def text_package(parts: Mapping[str, bytes]) -> bytes:
    text = b"# MathWorks OPC Text Package\nModel {\n  Version 24.1\n}\n__MWOPC_PACKAGE_BEGIN__ R2024a\n"
    for name, part in parts.items():
        is_xml = name.endswith((".xml", ".rels"))
        text += f"__MWOPC_PART_BEGIN__ /{name}{'' if is_xml else ' BASE64'}\n".encode()
        text += (part if is_xml else base64.encodebytes(part)) + b"\n"
    return text + b"__MWOPC_PACKAGE_END__\n"


def parts_of(drawn: Model, *, split: bool) -> dict[str, bytes]:
    """Return the parts of a package, among them some that say nothing of the model."""
    top = Element("ModelInformation", Version="1.0")
    inside = SubElement(top, drawn.kind)
    _add_values(inside, {"Version": "10.7", **drawn.callbacks})
    parts = {"[Content_Types].xml": Element("Types"), "simulink/windowsInfo.xml": Element("Object")}
    parts["simulink/blockdiagram.xml"] = top
    configuration = _xml_configuration(drawn.settings)
    defaults = Element("BlockParameterDefaults")
    for kind, values in drawn.defaults.items():
        _add_values(SubElement(defaults, "Block", BlockType=kind), values)
    if split:
        parts["simulink/configSet0.xml"] = sets = Element("ConfigSet")
        sets.append(configuration)
        parts["simulink/configSetInfo.xml"] = info = Element("ConfigSetInfo")
        SubElement(info, "ConfigSet", PartName="/simulink/configSet0.xml", Active="true").text = "Configuration"
        parts["simulink/bddefaults.xml"] = kept = Element("BlockDiagramDefaults")
        kept.append(defaults)
        inside.append(_xml_system(drawn.system, "root", parts))
    else:
        array = SubElement(inside, "Array", PropName="ConfigurationSets", Type="Handle", Dimension="1*1")
        array.append(configuration)
        inside.append(defaults)
        inside.append(_xml_system(drawn.system, "root", None))
    charts = [one for one in drawn.system.walk() if one.script]
    if charts:
        _add_charts(charts, parts, split)
    written = {name: _xml(element) for name, element in parts.items()}
    return {**written, "metadata/thumbnail.png": b"\x89PNG\r\n\x1a\n\0\0"}


def _xml(element: Element) -> bytes:
    ElementTree.indent(element)
    text = ElementTree.tostring(element, "unicode").replace("\r", "&#13;")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{text}'.encode()


def _add_values(element: Element, values: Mapping[str, str]) -> None:
    for key, value in values.items():
        SubElement(element, "P", Name=key).text = value


def _xml_configuration(settings: Mapping[str, str]) -> Element:
    configuration = Element("Object", ObjectID="1", Version="23.1.0", ClassName="Simulink.ConfigSet")
    array = SubElement(configuration, "Array", PropName="Components", Type="Handle", Dimension="1*2")
    solver = SubElement(array, "Object", ObjectID="2", Version="23.1.0", ClassName="Simulink.SolverCC")
    _add_values(solver, settings)
    SubElement(array, "Object", ObjectID="3", Version="23.1.0", ClassName="Simulink.DataIOCC")
    return configuration


def _xml_system(inside: System, name: str, parts: dict[str, Element] | None) -> Element:
    """Return the element of a system, or one that refers to it where systems are parts of their own."""
    element = Element("System")
    _add_values(element, {"Location": "[2, 78, 1022, 740]", "Open": "on"})
    if parts is not None:
        parts[f"simulink/systems/system_{name}.xml"] = element
    for one in inside.blocks.values():
        element.append(_xml_block(one, parts))
    for drawn in inside.lines:
        element.append(_xml_line(drawn, inside))
    for k, note in enumerate(inside.annotations):
        below = SubElement(element, "Annotation", SID=str(1000 + k))
        _add_values(below, {"Name": note.text, "Position": note.position})
    return element if parts is None else Element("System", Ref=f"system_{name}")


def _xml_block(one: Block, parts: dict[str, Element] | None) -> Element:
    element = Element("Block", BlockType=one.type, Name=one.name, SID=one.sid)
    if one.ports and parts is not None:
        SubElement(element, "PortCounts", {key: str(count) for key, count in one.ports.items()})
    elif one.ports:
        _add_values(element, {"Ports": _port_list(one.ports)})
    of_a_link = {key: value for key, value in one.values.items() if one.type == "Reference" and key not in _OF_THE_LINK}
    _add_values(element, {key: value for key, value in one.values.items() if key not in of_a_link})
    if of_a_link:
        _add_values(SubElement(element, "InstanceData"), of_a_link)
    if one.mask is not None:
        mask = SubElement(element, "Mask")
        SubElement(mask, "Type").text = one.mask.type
        SubElement(mask, "Initialization").text = one.mask.initialization
        for key, value in one.mask.parameters.items():
            parameter = SubElement(mask, "MaskParameter", Name=key, Type="edit")
            SubElement(parameter, "Prompt").text = "?"
            SubElement(parameter, "Value").text = value
    if one.system is not None:
        element.append(_xml_system(one.system, one.sid.replace(":", "_"), parts))
    return element


def _xml_line(drawn: Line, inside: System) -> Element:
    def written(key: str, end: End, side: str) -> dict[str, str]:
        port = f"{side}:{end.port}" if end.port.isdecimal() else end.port
        return {key: f"{inside.blocks[end.block].sid}#{port}"}

    node = Node("Line", {"Name": drawn.name, "Labels": "[0, 0]"} if drawn.name else {})
    node.values |= written("Src", drawn.source, "out") if drawn.source else {}
    _branches(node, _ends(drawn), lambda end: written("Dst", end, "in"))
    return _xml_node(node)


def _xml_node(node: Node) -> Element:
    element = Element(node.kind)
    _add_values(element, node.values)
    element.extend(_xml_node(child) for child in node.children)
    return element


def _add_charts(charts: list[Block], parts: dict[str, Element], split: bool) -> None:
    top = Element("Stateflow")
    parts["simulink/stateflow/machine.xml" if split else "simulink/stateflow.xml"] = top
    machine = SubElement(SubElement(top, "machine", id="1"), "Children")
    for k, one in enumerate(charts):
        number, name = str(10 * k + 2), "/".join(one.path)
        chart = Element("chart", id=number)
        _add_values(chart, {"name": name, "type": "EML_CHART"})
        _add_values(SubElement(chart, "eml"), {"name": "fcn"})
        state = SubElement(SubElement(chart, "Children"), "state", SSID="1")
        _add_values(state, {"labelString": "eML_blk_kernel()"})
        _add_values(SubElement(state, "eml"), {"isEML": "1", "script": one.script})
        if split:
            parts[f"simulink/stateflow/chart_{number}.xml"] = chart
            SubElement(machine, "chart", Ref=f"chart_{number}")
        else:
            machine.append(chart)
        _add_values(SubElement(top, "instance", id=str(10 * k + 4)), {"machine": "1", "name": name, "chart": number})
