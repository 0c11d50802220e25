"""Broken diagrams and studies: which codes are told in which places, for one change each.

The table was told by two readers that checked these files key by key; the grammar of files must tell the same.
"""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from blocks.model import document
from blocks.studies import study
from blocks.text.errors import ModelError
from tests.support.documents import CONTROLLED
from tests.support.documents import STUDY as WHOLE_STUDY

STUDY: dict[str, Any] = {key: part for key, part in WHOLE_STUDY.items() if key not in ("sweeps", "tunings")}
STUDY |= {"claims": WHOLE_STUDY["claims"][:3], "figures": WHOLE_STUDY["figures"][:1]}
FMU = {"fmu": "../x.fmu", "kind": "ME", "isolate": True, "timeout": 10, "parameters": {"a[1]": 1}}
FMU_VARIANT = {"fmu": "y.fmu", "kind": "CS", "ports": {"a": "b"}}
DIAGRAM = {**CONTROLLED, "blocks": {**CONTROLLED["blocks"], "f": {**FMU, "variants": {"v": FMU_VARIANT}}}}
# What stands at a path of a file is replaced, ... takes it out: the code, line, column and place of every fault.
BROKEN: list[tuple[dict[str, Any], str, Any, list[str]]] = [
    (DIAGRAM, "", 5, ["E006 1:1 "]),
    (DIAGRAM, "name", "two words", ["E111 5:10 name"]),
    (DIAGRAM, "name", None, ["E111 5:10 name"]),
    (DIAGRAM, "doc", 5, ["E004 6:9 doc"]),
    (DIAGRAM, "doc", [1], ["E004 6:9 doc"]),
    (DIAGRAM, "$schema", 5, ["E004 2:13 $schema"]),
    (DIAGRAM, "blokcs", {}, ["E003 332:2 blokcs"]),
    (DIAGRAM, "stop", 1, ["E003 332:2 stop"]),
    (DIAGRAM, "parameters", [], ["E004 10:16 parameters"]),
    (DIAGRAM, "parameters/2k", 1, ["E111 28:3 parameters.2k"]),
    (DIAGRAM, "parameters/k", None, ["E004 11:8 parameters.k"]),
    (DIAGRAM, "parameters/k", {"unit": "V"}, ["E009 11:8 parameters.k"]),
    (DIAGRAM, "parameters/k", {"value": {}, "unit": 5}, [
        "E004 12:13 parameters.k.value",
        "E004 13:12 parameters.k.unit",
    ]),
    (DIAGRAM, "parameters/k", [1, [True, None]], ["E004 14:5 parameters.k.1.0", "E004 15:5 parameters.k.1.1"]),
    (DIAGRAM, "parameters/k", {"csv": 5}, ["E004 12:11 parameters.k.csv", "E009 11:8 parameters.k"]),
    (DIAGRAM, "parameters/rows", [[True], "=k"], ["E004 22:5 parameters.rows.0.0"]),
    (DIAGRAM, "inputs/r", "V", ["E004 30:8 inputs.r"]),
    (DIAGRAM, "inputs/r/size", [2, 1.5], ["E004 36:12 inputs.r.size"]),
    (DIAGRAM, "inputs/r/default", [1, "x"], ["E004 34:5 inputs.r.default.1"]),
    (DIAGRAM, "inputs/r/default", [1, 2, 3], ["E004 32:15 inputs.r.default"]),
    (DIAGRAM, "inputs/r/type", "enum", ["E004 31:12 inputs.r.unit", "E004 37:12 inputs.r.type"]),
    (DIAGRAM, "inputs/go/unit", "V", ["E004 54:12 inputs.go.unit"]),
    (DIAGRAM, "inputs/mode/default", "up", ["E004 49:15 inputs.mode.default"]),
    (DIAGRAM, "inputs/mode/type", {"enum": "", "members": {"a": 1}}, [
        "E004 273:6 run.inputs.mode.u.0",
        "E004 274:6 run.inputs.mode.u.1",
        "E004 41:12 inputs.mode.type",
        "E004 47:15 inputs.mode.default",
    ]),
    (DIAGRAM, "inputs/mode/type/members", {"a": 1, "b": 1, "": 2, "c": 0.5}, [
        "E004 277:6 run.inputs.mode.u.0",
        "E004 278:6 run.inputs.mode.u.1",
        "E004 45:11 inputs.mode.type.members.b",
        "E004 46:6 inputs.mode.type.members.",
        "E004 47:11 inputs.mode.type.members.c",
        "E004 51:15 inputs.mode.default",
    ]),
    (DIAGRAM, "inputs/count/default", 1.5, ["E004 58:15 inputs.count.default"]),
    (DIAGRAM, "outputs/y", 5, ["E004 62:8 outputs.y"]),
    (DIAGRAM, "outputs/a.b", "sine.y", ["E111 63:3 outputs.a.b"]),
    (DIAGRAM, "blocks/sine", 5, ["E004 65:11 blocks.sine"]),
    (DIAGRAM, "blocks/sine", {"doc": 1}, ["E009 65:3 blocks.sine"]),
    (DIAGRAM, "blocks/sine/fmu", "a.fmu", ["E003 65:3 blocks.sine"]),
    (DIAGRAM, "blocks/sine/type", "", ["E004 66:12 blocks.sine.type"]),
    (DIAGRAM, "blocks/sine/typ", "Sine", ["E003 75:4 blocks.sine.typ"]),
    (DIAGRAM, "blocks/sine/kind", "XX", ["E003 75:4 blocks.sine.kind"]),
    (DIAGRAM, "blocks/sine/enable", {"states": 1}, [
        "E003 75:4 blocks.sine.enable",
        "E004 76:15 blocks.sine.enable.states",
    ]),
    (DIAGRAM, "blocks/sine/parameters/omega", None, ["E004 73:14 blocks.sine.parameters.omega"]),
    (DIAGRAM, "blocks/noise/stream", "a..b", ["E111 78:14 blocks.noise.stream"]),
    (DIAGRAM, "blocks/noise/stream", 1, ["E004 78:14 blocks.noise.stream"]),
    (DIAGRAM, "blocks/f/fmu", "//host/a.fmu", ["E007 194:11 blocks.f.fmu"]),
    (DIAGRAM, "blocks/f/timeout", 0, ["E004 197:15 blocks.f.timeout"]),
    (DIAGRAM, "blocks/f/isolate", 1, ["E004 196:15 blocks.f.isolate"]),
    (DIAGRAM, "blocks/f/kind", "cs", ["E004 195:12 blocks.f.kind"]),
    (DIAGRAM, "blocks/sum/diagram/version", 1, ["E003 121:5 blocks.sum.diagram.version"]),
    (DIAGRAM, "blocks/sum/diagram/blocks/x y", {"type": "Gain"}, ["E111 111:6 blocks.sum.diagram.blocks.x y"]),
    (DIAGRAM, "blocks/sum/trigger", {"every": 1}, ["E003 126:4 blocks.sum.trigger"]),
    (DIAGRAM, "blocks/edges/trigger", {}, ["E009 169:15 blocks.edges.trigger"]),
    (DIAGRAM, "blocks/edges/trigger/offset", 1, ["E003 171:5 blocks.edges.trigger.offset"]),
    (DIAGRAM, "blocks/edges/trigger/direction", "rising", ["E004 170:18 blocks.edges.trigger.direction"]),
    (DIAGRAM, "blocks/ticks/trigger/every", [None], ["E004 146:6 blocks.ticks.trigger.every.0"]),
    (DIAGRAM, "blocks/plant/variant", "nine", ["E122 175:15 blocks.plant.variant"]),
    (DIAGRAM, "blocks/plant/variants/base", {"type": "Gain"}, ["E109 190:5 blocks.plant.variants.base"]),
    (DIAGRAM, "blocks/plant/variants/rough/ports/u", "", ["E004 183:12 blocks.plant.variants.rough.ports.u"]),
    (DIAGRAM, "blocks/plant/ports", {}, ["E003 192:4 blocks.plant.ports"]),
    (DIAGRAM, "blocks/r", {"type": "Gain"}, ["E109 211:3 blocks.r"]),
    (DIAGRAM, "wires/on.u", ["sine.y"], ["E004 213:11 wires.on.u"]),
    (DIAGRAM, "run/stopp", 1, ["E003 300:3 run.stopp"]),
    (DIAGRAM, "run/doc", 1, ["E004 284:10 run.doc"]),
    (DIAGRAM, "run/master", {"stp": 1}, ["E003 287:4 run.master.stp"]),
    (DIAGRAM, "run/inputs/r", {"t": 1, "u": [None], "inter": 1}, [
        "E003 254:5 run.inputs.r.inter",
        "E004 250:10 run.inputs.r.t",
        "E004 252:6 run.inputs.r.u.0",
    ]),
    (DIAGRAM, "run/inputs/mode", "up", ["E004 269:12 run.inputs.mode"]),
    (DIAGRAM, "run/inputs/go", {"value": "x", "unit": 1}, [
        "E004 269:14 run.inputs.go.value",
        "E004 270:13 run.inputs.go.unit",
    ]),
    (DIAGRAM, "run/inputs/r/interpolation", "cubic", ["E004 264:22 run.inputs.r.interpolation"]),
    (DIAGRAM, "measures/m", {"type": 5}, ["E004 303:12 measures.m.type", "E009 302:8 measures.m"]),
    (DIAGRAM, "measures/m/too", 1, ["E003 313:4 measures.m.too"]),
    (DIAGRAM, "layout/sine", [1], ["E004 322:11 layout.sine"]),
    (DIAGRAM, "layout/sin", [1, 2], ["E105 326:3 layout.sin"]),
    (STUDY, "name", "a b", ["E111 5:10 name"]),
    (STUDY, "doc", [1], ["E004 7:9 doc"]),
    (STUDY, "runs", [], [
        "E004 11:10 runs",
        "E105 20:3 claims.0",
        "E105 30:3 claims.1",
        "E105 38:3 claims.2",
        "E105 72:15 figures.0.panels.0.lines.0.run",
        "E105 88:15 figures.0.panels.0.markers.1.run",
    ]),
    (STUDY, "runs/a b", {"diagram": "d.json"}, ["E111 46:10 runs.a b"]),
    (STUDY, "runs/a", 5, ["E004 12:8 runs.a"]),
    (STUDY, "runs/a/diagram", "", ["E009 12:8 runs.a"]),
    (STUDY, "runs/a/parameters/k", None, ["E004 15:10 runs.a.parameters.k"]),
    (STUDY, "runs/a/settings/stpo", 1, ["E003 40:5 runs.a.settings.stpo"]),
    (STUDY, "runs/a/settings/inputs/u/t", 5, ["E004 30:12 runs.a.settings.inputs.u.t"]),
    (STUDY, "runs/a/variants/m", 1, ["E004 22:10 runs.a.variants.m"]),
    (STUDY, "assumed", [1], ["E004 47:13 assumed"]),
    (STUDY, "assumed/0/what", 1, ["E004 49:12 assumed.0.what"]),
    (STUDY, "claims/0/measure", "", ["E009 55:3 claims.0"]),
    (STUDY, "claims/0/run", "nobody", ["E105 55:3 claims.0"]),
    (STUDY, "claims/0/runs", ["a", "b"], ["E009 55:3 claims.0"]),
    (STUDY, "claims/0/tolerance", 2, ["E004 61:17 claims.0.tolerance"]),
    (STUDY, "claims/0/published", 0, ["E004 58:17 claims.0.published"]),
    (STUDY, "claims/0/reason", "", ["E009 55:3 claims.0"]),
    (STUDY, "claims/1/as", ..., ["E004 65:3 claims.1"]),
    (STUDY, "claims/2/expect", "perhaps", ["E004 77:14 claims.2.expect", "E009 73:3 claims.2"]),
    (STUDY, "figures/0/name", "a b", ["E111 80:3 figures.0"]),
    (STUDY, "figures/0/panels", [], ["E009 80:3 figures.0"]),
    (STUDY, "figures/0/kind", "other", ["E004 84:12 figures.0.kind"]),
    (STUDY, "figures/0/panels/0/lines/0/run", "c", ["E105 107:15 figures.0.panels.0.lines.0.run"]),
    (STUDY, "figures/0/panels/0/lines/0/signal", ..., ["E009 106:7 figures.0.panels.0.lines.0"]),
    (STUDY, "figures/0/panels/0/lines/0/style", 9, ["E004 110:17 figures.0.panels.0.lines.0.style"]),
    (STUDY, "figures/0/panels/0/markers/0/x", ..., ["E009 116:7 figures.0.panels.0.markers.0"]),
    (STUDY, "figures/0/panels/0/band", [1], ["E004 127:14 figures.0.panels.0.band"]),
    (STUDY, "figures/0/panels/0/height", 0, ["E004 138:16 figures.0.panels.0.height"]),
    (STUDY, "figures/0/panels/0/log", 1, ["E004 137:13 figures.0.panels.0.log"]),
]  # fmt: skip


def changed(source: dict[str, Any], where: str, value: Any) -> Any:
    """The document with another value at a path; ... takes out what stands there."""
    made: Any = copy.deepcopy(source)
    node, (*around, last) = made, where.split("/")
    for step in around:
        node = node[int(step) if isinstance(node, list) else step]
    if value is ...:
        del node[last]
    else:
        node[last] = value
    return made if where else value


@pytest.mark.parametrize(
    ("source", "where", "value", "told"), BROKEN, ids=[f"{k} {where}" for k, (_, where, _, _) in enumerate(BROKEN)]
)
def test_every_fault_has_its_code_and_its_place(
    source: dict[str, Any], where: str, value: Any, told: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps(changed(source, where, value), indent=1, ensure_ascii=False), encoding="utf-8")
    with pytest.raises(ModelError) as error:
        (study if source is STUDY else document).load(path)
    faults = {f"{fault.code} {fault.line}:{fault.column} {fault.place}" for fault in error.value.faults}
    assert sorted(faults) == told
    for fault in error.value.faults:
        assert fault.message.endswith((".", "]")), fault
        assert "must be ," not in fault.message
