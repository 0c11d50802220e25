"""Models of Simulink: one tree from every form of file, and an error with a cause for everything else."""

from __future__ import annotations

import base64
import contextlib
import os
import random
import re
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings

from blocks.simulink import Annotation, Block, Mask, Model, System, package, read_model, reading
from blocks.text.errors import ModelError
from tests.support.simulink_files import (
    COMFORT,
    FORMS,
    bare,
    block,
    dc_motor,
    house,
    line,
    mdl_text,
    model,
    models,
    packed,
    parts_of,
    system,
    text_package,
    write_inline,
    write_mdl,
    write_split,
)

DIAGRAM = "simulink/blockdiagram.xml"
ROOT_PART = "simulink/systems/system_root.xml"
EVERY_FORM = pytest.mark.parametrize("form", FORMS)


def code_of(path: Path) -> tuple[str, str]:
    """Return code and text of the error that reading raises."""
    with pytest.raises(ModelError) as caught:
        read_model(path)
    for fault in caught.value.faults:
        assert fault.place or fault.file
        assert fault.cure
        assert fault.message.endswith(".")
        assert "\n" not in str(fault)
        assert "FMU" not in str(fault).replace(path.name, "")
    return caught.value.code, str(caught.value)


def from_text(text: str | bytes, folder: Path) -> Model:
    path = folder / "some.mdl"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_model(path)


def line_of(text: str, piece: str) -> int:
    return text[: text.index(piece)].count("\n") + 1


def at(read: Model, *path: str) -> Block:
    return next(one for one in read.system.walk() if one.path == path)


# --- one tree from every form -----------------------------------------------------------------------------------------


@EVERY_FORM
@pytest.mark.parametrize("drawn", [dc_motor, house])
def test_every_form_gives_the_model_that_was_drawn(form: str, drawn: Callable[[], Model], tmp_path: Path) -> None:
    path = FORMS[form](drawn(), tmp_path)
    read = read_model(path)
    assert read.path == path
    assert bare(read) == drawn()


TACHO_MDL = r"""# MathWorks
Model {
  Name                    "tacho"
  Version                 7.5
  GraphicalInterface {
    NumRootInports          1
    ParameterArgumentNames  ""
  }
  SavedCharacterEncoding  "windows-1252"
  InitFcn                 "k = 2;\n% \"Wert\", der"
  " in die n\\chste Zeile geht"
  Array {
    Type                    "Handle"
    Dimension               1
    Simulink.ConfigSet {
      $ObjectID               1
      Array {
        Type                    "Handle"
        Dimension               2
        Simulink.SolverCC {
          $ObjectID               2
          StartTime               "0.0"
          StopTime                "10"
          Solver                  "ode45"
        }
        Simulink.DataIOCC {
          $ObjectID               3
          StopTime                "none"
        }
        PropName                "Components"
      }
      Name                    "Configuration"
    }
    PropName                "ConfigurationSets"
  }
  BlockParameterDefaults {
    Block {
      BlockType               Gain
      Gain                    "1"
      SaturateOnIntegerOverflow on
    }
  }
  System {
    Name                    "tacho"
    Location                [70, 71, 884, 604]
    Block {
      BlockType               Gain
      Name                    "Gr\xf6\xdfe\n1/2"
      SID                     "1"
      Position                [290, 112,
      345, 158]
      Gain                    "[k, 2;"
      " 3, 4]"
    }
    Block {
      BlockType               SubSystem
      Name                    "Sub"
      SID                     "2"
      Ports                   [1, 1, 0, 1]
      MaskType                "Sensor"
      MaskPromptString        "a|b"
      MaskVariables           "a=@1;b=&2;"
      MaskValueString         "2*k|'x\\|y'"
      MaskInitialization      "c = a;"
      System {
        Name                    "Sub"
        Block {
          BlockType               Inport
          Name                    "In1"
          SID                     "3"
        }
      }
    }
    Line {
      Name                    "n"
      Labels                  [0, 0]
      SrcBlock                "Gr\xf6\xdfe\n1/2"
      SrcPort                 1
      Points                  [95, 0]
      Branch {
        DstBlock                "Sub"
        DstPort                 trigger
      }
      Branch {
        Points                  [0, -130]
        Branch {
          DstBlock                "Sub"
          DstPort                 1
        }
        Branch {
          Points                  [10, 0]
        }
      }
    }
    Line {
      Labels                  [1, 1]
      SrcBlock                "Sub"
      SrcPort                 1
      Points                  [20, 0]
    }
    Annotation {
      Name                    "Tacho: 5 \x80"
      Position                [1, 2]
    }
  }
}
"""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_text_of_an_older_release_is_read_as_it_is_written(end: str, tmp_path: Path) -> None:
    raw = re.sub("(?m)^ {8}", "\t", TACHO_MDL).replace("\n", end).encode()
    for byte in (0xF6, 0xDF, 0x80):
        raw = raw.replace(b"\\x%02x" % byte, bytes([byte]))
    read = from_text(raw, tmp_path)
    name = "Größe\n1/2"
    inner, ports = block("Inport", "In1", 3), {"in": 1, "out": 1, "trigger": 1}
    sensor = {
        "MaskType": "Sensor",
        "MaskPromptString": "a|b",
        "MaskVariables": "a=@1;b=&2;",
        "MaskValueString": r"2*k|'x\|y'",
        "MaskInitialization": "c = a;",
    }
    mask = Mask("Sensor", {"a": "2*k", "b": "'x|y'"}, "c = a;")
    assert bare(read) == model(
        "tacho",
        system(
            [
                block("Gain", name, 1, {"Position": "[290, 112, 345, 158]", "Gain": "[k, 2; 3, 4]"}),
                block("SubSystem", "Sub", 2, sensor, ports, inside=system([inner]), mask=mask),
            ],
            [
                line((name, "1"), ("Sub", "trigger"), ("Sub", "1"), name="n", open_ends=1),
                line(("Sub", "1"), open_ends=1),
            ],
            [Annotation("Tacho: 5 €", "[1, 2]")],
        ),
        settings={"StartTime": "0.0", "StopTime": "10", "Solver": "ode45"},
        defaults={"Gain": {"Gain": "1", "SaturateOnIntegerOverflow": "on"}},
        callbacks={"InitFcn": 'k = 2;\n% "Wert", der in die n\\chste Zeile geht'},
    )
    assert read.system.values["Location"] == "[70, 71, 884, 604]"
    assert at(read, name).line == line_of(TACHO_MDL, "System {") + 3
    assert read.value(at(read, name), "SaturateOnIntegerOverflow") == "on"
    assert read.value(at(read, name), "Gain") == "[k, 2; 3, 4]"
    assert read.value(at(read, name), "Multiplication") is None


SPLIT = {
    DIAGRAM: """<?xml version="1.0" encoding="utf-8"?>
<ModelInformation Version="1.0">
  <Model>
    <P Name="ModelUUID">fa4bbeb1</P>
    <EngineSettings>
      <P Name="InitFcn">not of the model</P>
    </EngineSettings>
    <P Name="PreLoadFcn">k = 2; % &lt;&amp;&gt;
</P>
    <System Ref="system_root"/>
  </Model>
</ModelInformation>""",
    ROOT_PART: """<?xml version="1.0" encoding="utf-8"?>
<System>
  <P Name="Location">[160, 548, 1603, 1406]</P>
  <Block BlockType="Gain" Name="Gr&#xF6;&#xdf;e&#xA;&quot;1/2&quot;" SID="1">
    <PortCounts in="1" out="1"/>
    <P Name="Gain"> k </P>
    <P Name="Description"/>
  </Block>
  <Block BlockType="Reference" Name="Solver" SID="4">
    <PortCounts lconn="1" rconn="2"/>
    <P Name="SourceBlock">nesl_utility/Solver&#xA;Configuration</P>
    <InstanceData>
      <P Name="DoDC">off</P>
      <P Name="Ref" Ref="bdmxdata:Ref_4"/>
    </InstanceData>
  </Block>
  <Block BlockType="SubSystem" Name="Sub" SID="12">
    <PortCounts in="1" trigger="1"/>
    <P Name="OpenFcn">open me</P>
    <System Ref="system_12"/>
  </Block>
  <Line>
    <P Name="ZOrder">1</P>
    <P Name="Labels">[1, 1]</P>
    <P Name="Src">1#out:1</P>
    <P Name="Points">[20, 0]</P>
    <Branch>
      <P Name="ZOrder">2</P>
      <P Name="Dst">12#trigger</P>
    </Branch>
    <Branch>
      <P Name="Dst">12#in:1</P>
    </Branch>
    <Branch>
      <P Name="Dst">99#in:1</P>
    </Branch>
  </Line>
  <Line LineType="Connection">
    <P Name="Src">4#rconn:2</P>
    <P Name="Dst">4#lconn:1</P>
  </Line>
</System>""",
    "simulink/systems/system_12.xml": """<?xml version="1.0" encoding="utf-8"?>
<System>
  <P Name="Open">off</P>
  <Block BlockType="Inport" Name="In1" SID="12::5"/>
</System>""",
}


def test_a_package_of_a_later_release_is_read_as_it_is_written(tmp_path: Path) -> None:
    read = read_model(packed(tmp_path / "tacho.slx", {name: text.encode() for name, text in SPLIT.items()}))
    name = 'Größe\n"1/2"'
    link = {"SourceBlock": "nesl_utility/Solver\nConfiguration", "DoDC": "off", "Ref": "bdmxdata:Ref_4"}
    sub = block(
        "SubSystem",
        "Sub",
        12,
        {"OpenFcn": "open me"},
        {"in": 1, "trigger": 1},
        inside=system([block("Inport", "In1", "12::5")]),
    )
    assert bare(read) == model(
        "tacho",
        system(
            [
                block("Gain", name, 1, {"Gain": " k ", "Description": ""}, {"in": 1, "out": 1}),
                block("Reference", "Solver", 4, link, {"lconn": 1, "rconn": 2}),
                sub,
            ],
            [
                line((name, "1"), ("Sub", "trigger"), ("Sub", "1"), open_ends=1),
                line(("Solver", "rconn2"), ("Solver", "lconn1")),
            ],
        ),
        callbacks={"PreLoadFcn": "k = 2; % <&>\n"},
    )
    assert (at(read, name).file, at(read, name).line) == (ROOT_PART, 4)
    assert (at(read, "Sub", "In1").file, at(read, "Sub", "In1").line) == ("simulink/systems/system_12.xml", 4)
    connection = read.system.lines[1]
    assert (connection.file, connection.line) == (ROOT_PART, line_of(SPLIT[ROOT_PART], "<Line LineType"))


def test_physical_ports_have_the_same_names_in_both_formats(tmp_path: Path) -> None:
    read = from_text(
        'Model {\nSystem {\nBlock {\nBlockType PMComponent\nName "R"\n}\nLine {\nLineType "Connection"\n'
        'SrcBlock "R"\nSrcPort RConn2\nDstBlock "R"\nDstPort LConn1\n}\n}\n}\n',
        tmp_path,
    )
    assert bare(read).system.lines == [line(("R", "rconn2"), ("R", "lconn1"))]


@pytest.mark.parametrize("encoding", ["windows-1252", "ISO-8859-1", "UTF-8"])
def test_the_encoding_that_a_text_names_is_taken(encoding: str, tmp_path: Path) -> None:
    assert bare(read_model(write_mdl(house(), tmp_path, encoding))) == house()


@pytest.mark.parametrize("named", ["US-ASCII", "UTF-8", "ibm-5348_P100-1997", "undefined", "punycode", "rot13", "hex"])
def test_an_encoding_that_is_wrong_or_unknown_is_replaced_by_that_of_windows(named: str, tmp_path: Path) -> None:
    text = mdl_text(house(), "windows-1252").replace(b'"windows-1252"', f'"{named}"'.encode())
    assert bare(from_text(text, tmp_path)).system == house().system


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    assert bare(from_text(b"\xef\xbb\xbf" + mdl_text(house()), tmp_path)) == house()


@EVERY_FORM
@pytest.mark.parametrize("kind", ["Library", "Subsystem"])
def test_a_library_and_a_subsystem_file_say_what_they_are(form: str, kind: str, tmp_path: Path) -> None:
    drawn = replace(dc_motor(), kind=kind)
    assert bare(read_model(FORMS[form](drawn, tmp_path))) == drawn


@EVERY_FORM
def test_the_text_of_a_matlab_function_is_found_by_the_path_of_its_block(form: str, tmp_path: Path) -> None:
    read = read_model(FORMS[form](house(), tmp_path))
    assert {one.path: one.script for one in read.system.walk() if one.script} == {("Küche", "Comfort"): COMFORT}


@EVERY_FORM
def test_blocks_are_walked_in_their_order_those_inside_after_their_block(form: str, tmp_path: Path) -> None:
    names = [one.name for one in read_model(FORMS[form](house(), tmp_path)).system.walk()]
    assert names == [
        *("weather", "Küche", "In1", "Comfort", " Demux ", "Wände\nund Dach", "heat", "Enable", "T", "out", "20 °C"),
        *("Out1", "If", "Sommer, Herbst", "Action Port", "counter", "Trigger", "\\"),
    ]


def test_a_model_of_slx_is_named_by_its_file(tmp_path: Path) -> None:
    assert read_model(write_split(house(), tmp_path).rename(tmp_path / "other.slx")).name == "other"


def test_of_several_sets_of_settings_the_active_one_counts(tmp_path: Path) -> None:
    drawn = dc_motor()
    parts = parts_of(drawn, split=True)
    other = parts["simulink/configSet0.xml"].replace(b">5*T<", b">9<")
    info = '<ConfigSetInfo><ConfigSet PartName="/simulink/configSet{}.xml"{}>{}</ConfigSet>{}</ConfigSetInfo>'
    active = ' Active="true"'
    for first, second, stop in ((active, "", "5*T"), ("", active, "9"), ("", "", "5*T")):
        more = f'<ConfigSet PartName="/simulink/configSet1.xml"{second}>b</ConfigSet>'
        parts["simulink/configSetInfo.xml"] = info.format(0, first, "a", more).encode()
        path = packed(tmp_path / "dc_motor.slx", {**parts, "simulink/configSet1.xml": other})
        assert read_model(path).settings == {**drawn.settings, "StopTime": stop}


@pytest.mark.parametrize(("number", "stop"), [("1", "5*T"), ("11", "9"), ("99", "5*T")])
def test_of_several_sets_of_settings_in_a_text_the_active_one_counts(number: str, stop: str, tmp_path: Path) -> None:
    text = mdl_text(dc_motor()).decode()
    begin = text.index("    Simulink.ConfigSet {")
    end = text.index("\n    }\n", begin) + len("\n    }\n")
    one = text[begin:end]
    assert one.count("{") == one.count("}")
    other = one.replace('"5*T"', '"9"').replace("$ObjectID\t\t1\n", "$ObjectID\t\t11\n")
    assert other != one
    text = text[:end] + other + text[end:]
    name = '$PropName\t\t"ActiveConfigurationSet"\n    $ObjectID\t\t'
    assert name in text
    text = text.replace(f"{name}1\n", f"{name}{number}\n")
    assert from_text(text, tmp_path).settings == {**dc_motor().settings, "StopTime": stop}


@EVERY_FORM
def test_settings_that_a_variable_holds_are_not_those_of_another_set(form: str, tmp_path: Path) -> None:
    """The active set may be a reference to a variable; then the file has the settings of inactive sets only."""
    drawn, parts = dc_motor(), parts_of(dc_motor(), split=form != "inline")
    path = tmp_path / "dc_motor.slx"
    if form == "mdl":
        text = mdl_text(drawn).decode()
        held = '  Array {\n    Simulink.ConfigSetRef {\n      $ObjectID 9\n      WSVarName "c"\n    }\n  }\n'
        active = 'Simulink.ConfigSet {\n    $PropName\t\t"ActiveConfigurationSet"\n    $ObjectID\t\t1\n'
        assert active in text
        text = text.replace(active, active.replace("Set {", "SetRef {").replace("\t1\n", "\t9\n"))
        path.write_text(text.replace("  BlockDefaults", f"{held}  BlockDefaults"))
    elif form == "inline":
        held = '<Object ObjectID="9" ClassName="Simulink.ConfigSetRef"><P Name="WSVarName">c</P></Object>'
        active = '<Object Reference="true" PropName="ActiveConfigurationSet" ObjectID="9" ClassName="{}"/>'
        more = f"<Array>{held}</Array>{active.format('Simulink.ConfigSetRef')}</Model>"
        packed(path, {**parts, DIAGRAM: parts[DIAGRAM].replace(b"</Model>", more.encode())})
    else:
        info = parts["simulink/configSetInfo.xml"].replace(b"configSet0", b"configSet1")
        held = '<ConfigSet><Object ClassName="Simulink.ConfigSetRef"><P Name="WSVarName">c</P></Object></ConfigSet>'
        parts |= {"simulink/configSetInfo.xml": info, "simulink/configSet1.xml": held.encode()}
        if form == "split":
            packed(path, parts)
        else:
            path.write_bytes(text_package(parts))
    read = read_model(path)
    assert read.settings == {}
    assert read.unread == ("the settings of the solver",)
    assert bare(read).system == drawn.system


@EVERY_FORM
def test_a_function_inside_a_chart_of_states_is_not_the_text_of_its_block(form: str, tmp_path: Path) -> None:
    path = FORMS[form](house(), tmp_path)
    if path.suffix == ".mdl":
        path.write_bytes(path.read_bytes().replace(b"EML_CHART", b"TRUTH_TABLE_CHART"))
    else:
        parts = parts_of(house(), split=form == "split")
        packed(path, {name: part.replace(b"EML_CHART", b"TRUTH_TABLE_CHART") for name, part in parts.items()})
    assert [one.script for one in read_model(path).system.walk() if one.script] == []


def test_a_text_package_of_windows_is_read(tmp_path: Path) -> None:
    text = text_package(parts_of(house(), split=True)).replace(b"\n", b"\r\n")
    read = from_text(b"\xef\xbb\xbf" + text, tmp_path)
    assert bare(read) == replace(house(), name="some")


def test_a_part_in_base64_is_read(tmp_path: Path) -> None:
    parts = parts_of(house(), split=True)
    plain, root = text_package(parts), parts[ROOT_PART]
    coded = plain.replace(b"xml\n" + root, b"xml BASE64\n" + base64.encodebytes(root))
    assert coded != plain
    assert bare(from_text(coded, tmp_path)) == replace(house(), name="some")


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(drawn=models())
def test_random_models_are_the_same_in_every_form(drawn: Model, tmp_path: Path) -> None:
    for form, write in FORMS.items():
        assert bare(read_model(write(drawn, tmp_path))) == drawn, form


# --- what is no model -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"", "the file is empty"),
        (b" \r\n\n", "the file is empty"),
        (b"\0\5\x16\7\0\2\0\0Mac OS X        ", "is what macOS notes about a file"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "pointer of Git LFS"),
        (b"\xff\xfeM\0o\0d\0e\0l\0 \0{\0", "neither a package nor a text"),
        (b"function y = f(x)\ny = x;\n", "begins no Model"),
        (b"Model {\n", "the text ends within Model of line 1"),
        (b"Model {\n}\n", "holds no system of blocks"),
        (b"Model {\n}\n}\n", "a closing brace has no opening one"),
        (b"Model {\n  System {\n", "the text ends within System of line 2"),
        (b"Model {\n System {\n }\n}\nfoo bar\n", "is no parameter"),
        (b"# MathWorks OPC Text Package\nModel {\n}\n", "the package holds no simulink/blockdiagram.xml"),
        (b"PK\3\4", "the archive is truncated"),
        (b"PK", "not a zip archive"),
    ],
)
def test_what_is_no_model_is_refused_with_its_cause(data: bytes, what: str, tmp_path: Path) -> None:
    path = tmp_path / "._x.mdl"
    path.write_bytes(data)
    code, text = code_of(path)
    assert code == "E010"
    assert what in text


def test_the_notes_of_macos_name_the_model_that_they_belong_to(tmp_path: Path) -> None:
    (tmp_path / "._plant.mdl").write_bytes(b"\0\5\x16\7\0\2\0\0")
    assert "not the model: plant.mdl is" in code_of(tmp_path / "._plant.mdl")[1]


def test_a_path_that_cannot_be_read_says_so(tmp_path: Path) -> None:
    assert code_of(tmp_path)[0] == "E007"
    code, text = code_of(tmp_path / "none.slx")
    assert code == "E007"
    assert "No such file" in text
    with pytest.raises(ModelError, match="E007"):
        read_model("x\0.slx")


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.slx")
    assert code_of(tmp_path / "x.slx")[0] == "E007"


def test_a_text_that_is_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "MAX_TEXT", 1000)
    code, text = code_of(write_mdl(house(), tmp_path))
    assert code == "E010"
    assert "the file has more than 1,000 bytes" in text
    assert bare(read_model(write_split(house(), tmp_path))) == house()


def test_a_zip_without_a_block_diagram_is_refused(tmp_path: Path) -> None:
    code, text = code_of(packed(tmp_path / "x.slx", {ROOT_PART: b"<System/>"}))
    assert code == "E010"
    assert f"the archive holds no {DIAGRAM}" in text


@pytest.mark.parametrize(
    ("xml", "what"),
    [
        ('<!DOCTYPE a [<!ENTITY b "c">]><ModelInformation>&b;</ModelInformation>', "document type or an entity"),
        ('<!DOCTYPE a SYSTEM "/etc/passwd"><ModelInformation/>', "document type or an entity"),
        ("<ModelInformation>&b;</ModelInformation>", "undefined entity"),
        ("<ModelInformation><Model>", "not well-formed XML"),
        ("", "not well-formed XML"),
        ('<?xml version="1.0" encoding="utf-7"?><ModelInformation/>', "cannot be decoded"),
        ('<?xml version="1.0" encoding="none"?><ModelInformation/>', "unknown encoding"),
        ("<ModelInformation/>", "holds no system of blocks"),
        ("<ModelInformation><Model/></ModelInformation>", "holds no system of blocks"),
        ("<Model>" + "<System><Block>" * 40 + "</Block></System>" * 40 + "</Model>", "nested more than 60 deep"),
    ],
)
@pytest.mark.parametrize("is_text", [False, True])
def test_xml_that_is_damaged_or_does_harm_is_refused(xml: str, what: str, is_text: bool, tmp_path: Path) -> None:
    parts = {DIAGRAM: xml.encode()}
    path = tmp_path / "x.mdl"
    if is_text:
        path.write_bytes(text_package(parts))
    else:
        packed(path, parts)
    code, text = code_of(path)
    assert code == "E010"
    assert what in text


def test_a_part_that_grows_a_thousand_times_is_refused(tmp_path: Path) -> None:
    bomb = b"<ModelInformation>" + b" " * (17 * 2**20) + b"</ModelInformation>"
    code, text = code_of(packed(tmp_path / "x.slx", {DIAGRAM: bomb}))
    assert code == "E010"
    assert "unpacks from" in text


def test_a_part_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(package, "MAX_PART", 1000)
    code, text = code_of(write_inline(house(), tmp_path))
    assert code == "E010"
    assert f"{DIAGRAM} has " in text


@pytest.mark.parametrize("limit", ["MAX_PARTS", "MOST_ELEMENTS"])
@pytest.mark.parametrize("form", ["split", "text package"])
def test_parts_that_are_too_large_together_are_refused(
    limit: str, form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = parts_of(house(), split=True)
    assert max(map(len, parts.values())) < 3000
    path = FORMS[form](house(), tmp_path)
    assert bare(read_model(path)) == house()
    monkeypatch.setattr(package, limit, {"MAX_PARTS": 3000, "MOST_ELEMENTS": 30}[limit])
    code, text = code_of(path)
    assert code == "E010"
    assert "elements together" in text


@pytest.mark.parametrize("name", ["../evil.xml", "/etc/passwd", "simulink/../../evil.xml", "simulink\\evil.xml"])
def test_a_zip_with_names_that_leave_it_is_refused(name: str, tmp_path: Path) -> None:
    path = packed(tmp_path / "x.slx", {**parts_of(house(), split=True), name: b"<System/>"})
    assert code_of(path)[0] == "E010"
    assert [one.name for one in tmp_path.iterdir()] == ["x.slx"]


def test_a_part_that_is_there_twice_is_refused(tmp_path: Path) -> None:
    path = write_split(house(), tmp_path)
    with zipfile.ZipFile(path, "a") as made, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        made.writestr(DIAGRAM, b"<ModelInformation/>")
    code, text = code_of(path)
    assert code == "E010"
    assert "appears twice" in text


def referring(name: str, sid: int = 1) -> bytes:
    return f'<System><Block BlockType="SubSystem" Name="a" SID="{sid}"><System Ref="{name}"/></Block></System>'.encode()


TOP = b'<ModelInformation><Model><System Ref="system_root"/></Model></ModelInformation>'


@pytest.mark.parametrize(
    ("systems", "where"),
    [
        ({}, f"{DIAGRAM}:1:1"),
        ({"root": referring("system_1")}, f"{ROOT_PART}:1:1"),
        ({"root": referring("system_root")}, f"{ROOT_PART}:1:1"),
        ({"root": referring("system_1"), "1": referring("system_1")}, "simulink/systems/system_1.xml:1:1"),
        (
            {"root": referring("system_1"), "1": referring("system_2"), "2": referring("system_1")},
            "simulink/systems/system_2.xml:1:1",
        ),
        (
            {
                "root": b"<System>" + 2 * referring("system_1")[len("<System>") : -len("</System>")] + b"</System>",
                "1": b"<System/>",
            },
            f"{ROOT_PART}:1:1",
        ),
        ({"root": referring("../../blockdiagram")}, f"{ROOT_PART}:1:1"),
        ({"root": b'<System Ref="system_1"/>', "1": b'<System Ref="system_root"/>'}, "system_1.xml:1:1"),
    ],
)
def test_a_system_that_is_missing_or_taken_twice_is_refused(
    systems: dict[str, bytes], where: str, tmp_path: Path
) -> None:
    parts = {f"simulink/systems/system_{key}.xml": text for key, text in systems.items()}
    code, text = code_of(packed(tmp_path / "x.slx", {DIAGRAM: TOP, **parts}))
    assert code == "E010"
    assert "is no part of the package, or two blocks refer to it" in text
    assert where in text


# --- depth, names and sizes -------------------------------------------------------------------------------------------


def nested(depth: int) -> Model:
    inside = system([block("Ground", "last", depth)])
    for k in range(depth - 1, -1, -1):
        inside = system([block("SubSystem", f"s{k}", k, inside=inside)])
    return model("deep", inside)


@EVERY_FORM
def test_systems_lie_deep_in_every_form_and_too_deep_is_refused(form: str, tmp_path: Path) -> None:
    assert bare(read_model(FORMS[form](nested(25), tmp_path))) == nested(25)
    code, text = code_of(FORMS[form](nested(70), tmp_path))
    assert code == "E010"
    assert "more than 60 deep" in text


def test_thousands_of_open_braces_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.mdl"
    path.write_bytes(b"Model {\n" * 100_000)
    assert "more than 60 deep" in code_of(path)[1]


@EVERY_FORM
def test_two_blocks_of_one_name_are_refused_and_their_system_is_named(form: str, tmp_path: Path) -> None:
    twice = System({"a": block("Gain", "g\n1", 2), "b": block("Gain", "g\n1", 3)}, [], [], {})
    drawn = model("twice", system([block("SubSystem", "Sub", 1)]))
    drawn.system.blocks["Sub"] = replace(drawn.system.blocks["Sub"], system=twice)  # type: ignore[index]
    code, text = code_of(FORMS[form](drawn, tmp_path))
    assert code == "E010"
    assert r"two blocks of one system have the name 'g\n1'" in text
    assert "Sub" in text


def test_the_same_name_in_two_systems_is_allowed(tmp_path: Path) -> None:
    drawn = model("m", system([block("SubSystem", "a", 1, inside=system([block("Gain", "a", 2)]))]))
    assert bare(read_model(write_split(drawn, tmp_path))) == drawn


@pytest.mark.parametrize(
    "text",
    [
        b"Model {\n" + b"\n" * 2_000_000 + b"}",
        b"x\n" + b" \n" * 1_000_000,
        b"Model {\nSystem {\n}\nA [1\n" + b"2, 3\n" * 500_000 + b"}\n",
        b'Model {\nSystem {\n}\nA "' + b'"\n"' * 500_000 + b'"\n}\n',
        b'Model {\nSystem {\n}\nA "' + b"\\" * 2_000_001 + b"\n}\n",
        b'Model {\nSystem {\nBlock {\nMaskVariables "' + b"a=@" * 500_000 + b'"\n}\n}\n}\n',
        b"# MathWorks OPC Text Package\n" + b"__MWOPC_PART_BEGIN__ /a\n" * 100_000,
        b"# MathWorks OPC Text Package\n" + b"__MWOPC_PART_BEGIN__ /" + b"a" * 3_000_000,
        b'Model {\nSystem {\nBlock {\nMaskVariables "' + b"a" * 300_000 + b'"\n}\n}\n}\n',
        b"SavedCharacterEncoding " + b"\n" * 19_000 + b"Model {\nSystem {\n}\n}\n",
    ],
)
def test_long_files_of_no_sense_take_no_long_time(text: bytes, tmp_path: Path) -> None:
    with contextlib.suppress(ModelError):
        from_text(text, tmp_path)


# --- damaged files ----------------------------------------------------------------------------------------------------


def damaged(raw: bytes, chance: random.Random) -> bytes:
    """Return a text with some bytes changed, a piece cut out, or lines removed, doubled or moved."""
    data = bytearray(raw)
    lines = raw.splitlines(keepends=True)
    match chance.randrange(6):
        case 0:
            for _ in range(chance.randint(1, 8)):
                data[chance.randrange(len(data))] = chance.randrange(256)
        case 1:
            del data[chance.randrange(len(data)) :]
        case 2:
            first = chance.randrange(len(data))
            del data[first : first + chance.randint(1, 200)]
        case 3:
            first = chance.randrange(len(lines))
            del lines[first : first + chance.randint(1, 3)]
            return b"".join(lines)
        case 4:
            first = chance.randrange(len(lines))
            piece = lines[first : first + chance.randint(1, 12)]
            lines[first:first] = piece * chance.randint(1, 3)
            return b"".join(lines)
        case 5:
            first, second = chance.randrange(len(lines)), chance.randrange(len(lines))
            lines[first], lines[second] = lines[second], lines[first]
            return b"".join(lines)
    return bytes(data)


def read_damaged(form: str, seeds: range, folder: Path) -> set[str]:
    """Read one damaged file for each seed; return the codes of errors, and "read" where there was none."""
    outcomes: set[str] = set()
    path = folder / "x.slx"
    whole = {drawn.name: FORMS[form](drawn, folder).read_bytes() for drawn in (dc_motor(), house())}
    parts = {drawn.name: parts_of(drawn, split=form == "split") for drawn in (dc_motor(), house())}
    for seed in seeds:
        chance = random.Random(f"{form} {seed}")
        name = chance.choice([*whole])
        if form in ("inline", "split") and chance.random() < 0.7:  # or nearly all would fail by a checksum
            part = chance.choice([key for key in parts[name] if key.startswith("simulink/")])
            packed(path, {**parts[name], part: damaged(parts[name][part], chance)})
        else:
            path.write_bytes(damaged(whole[name], chance))
        found = {"read"}
        try:
            read_model(path)
        except ModelError as error:
            found = {fault.code for fault in error.faults}
        assert found <= {"read", "E007", "E010"}, seed
        outcomes |= found
    return outcomes


@EVERY_FORM
def test_damaged_files_are_read_or_refused(form: str, tmp_path: Path) -> None:
    # Some of each, or the damage is too small or too large.
    assert read_damaged(form, range(75), tmp_path) == {"read", "E010"}


@pytest.mark.long
@EVERY_FORM
def test_many_damaged_files_are_read_or_refused(form: str, tmp_path: Path) -> None:
    assert read_damaged(form, range(75, 1325), tmp_path) == {"read", "E010"}
