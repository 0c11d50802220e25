"""Reference pages from what the code says: block types, commands, error codes, measures, units, Python names.

Directives of this extension:

    {library}                    all block types, module by module, with their summaries
    {block} PID                  one block type
    {commands}                   every command of `blocks`, from its argparse help
    {codes}                      error codes: cause, cure and example
    {keys} RUN                   the keys of an object of a file, from the grammar; lines "key: text" say more of one
    {measures}, {units}, {functions}    tables
    {simulink-words}             what stands for Simulink's words, from blocks/model/simulink_words.json
    {python} Diagram             a public name, with its methods
    {drawing} diagrams/x.json    a diagram, drawn
    {plot} diagrams/x.json       a run of it, plotted: `signals` names the panels, or lines of Python make it
    {cards}                      a card for each page that is named: its first plot, its title, its question

The page of each module of the library is written to `library/` when a build begins, since modules come and go.

Longer than other modules because every directive stands here; each is short.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from blocktypes import (
    default_of,
    feedthrough,
    kind_of,
    meaning,
    module_texts,
    modules,
    ports_of,
    range_of,
    size_of,
    unit_of,
)
from docutils import nodes
from pygments.lexers.special import TextLexer
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from symbol import style_sheet, symbol

import blocks
import blocks.analysis
import blocks.graph
from blocks import cli
from blocks.cli.option_values import assignments
from blocks.contract.interface import Interface
from blocks.contract.type_texts import NO_NAMES, interface_of, names_of, pieces_of
from blocks.contract.variables import REQUIRED
from blocks.library import LIBRARY
from blocks.model import diagram_grammar, study_grammar
from blocks.model.diagram_grammar import MEASURES
from blocks.text import docstrings, formula_tree, formulas, units
from blocks.text.explanations import EXPLAINED, FOLDER, GROUPS, explained
from blocks.text.formula_tree import Names
from blocks.text.grammar import Choice, Constant

__all__ = ["setup"]

ROOT = Path(blocks.__file__).resolve().parent.parent
"""The project's folder, in which the diagrams lie."""


# --- texts -----------------------------------------------------------------------------------------------------


def raw(html: str) -> nodes.raw:
    return nodes.raw("", html, format="html")


def inline(text: str, names: Names | None, *, display: bool = False) -> list[nodes.Node]:
    """A text with its code and, where names are given, its formulas."""
    if names is None:
        parts: list[formulas.Part] = []
        for piece in re.split(r"(`[^`]+`)", text):
            is_code = piece.startswith("`") and len(piece) > 1
            parts.append(formulas.Code(piece[1:-1]) if is_code else formulas.Words(piece))
    else:
        parts = formulas.formulas_in(text, names)
    made: list[nodes.Node] = []
    for part in parts:
        if isinstance(part, formulas.Formula):
            made.append(raw(formulas.html(part, names or NO_NAMES, display=display)))
        elif isinstance(part, formulas.Code):
            made.append(nodes.literal(part.text, part.text))
        else:
            made.append(nodes.Text(part.text))
    return made


def paragraph(text: str, names: Names | None, *, display: bool = False, style: str = "") -> nodes.paragraph:
    return nodes.paragraph("", "", *inline(text, names, display=display), classes=[style] if style else [])


def body(pieces: Sequence[docstrings.Piece], names: Names | None) -> list[nodes.Node]:
    """The nodes of a docstring's pieces."""
    made: list[nodes.Node] = []
    for piece in pieces:
        if isinstance(piece, docstrings.Paragraph):
            made.append(paragraph(piece.text, names))
        elif isinstance(piece, docstrings.Lines):
            made.append(lines(piece, names))
        elif isinstance(piece, docstrings.References):
            made.append(nodes.rubric("", "References"))
            made += [paragraph(entry, None, style="reference-entry") for entry in piece.entries]
        elif piece.word:
            if not made or not isinstance(made[-1], nodes.definition_list):
                made.append(nodes.definition_list())
            what = nodes.definition("", paragraph(piece.text, names), *body(piece.pieces, names))
            term = nodes.term("", "", nodes.literal(piece.word, piece.word))
            made[-1] += nodes.definition_list_item("", term, what)
        else:
            if not made or not isinstance(made[-1], nodes.bullet_list):
                made.append(nodes.bullet_list())
            made[-1] += nodes.list_item("", paragraph(piece.text, names))
    return made


def lines(piece: docstrings.Lines, names: Names | None) -> nodes.Node:
    """Formulas, a line each; what cannot be read stays as it is written."""
    if names is None:
        text = "\n".join(" " * extra + line for extra, line in piece.lines)
        return nodes.literal_block(text, text, language="python" if "(" in text else "output")
    made = nodes.container(classes=["formulas"])
    for extra, line in piece.lines:
        style = ["further"] if extra else []
        if docstrings.is_readable(line, names):
            parts: list[nodes.Node] = []
            for column in re.split(r" {3,}", line):
                if parts:
                    parts.append(nodes.inline("", " ", classes=["gap"]))
                parts += inline(column, names, display=True)
            made += nodes.paragraph("", "", *parts, classes=style)
        else:
            made += nodes.paragraph("", "", nodes.literal(line, line), classes=style)
    return made


def table(
    head: Sequence[str], rows: Iterable[Sequence[Sequence[nodes.Node] | str]], widths: Sequence[int]
) -> nodes.table:
    """A table; a cell is a text, with code in backquotes, or nodes. Columns that are empty are left out."""
    kept_rows = [list(row) for row in rows]
    keep = [k for k in range(len(head)) if any(row[k] for row in kept_rows)]
    group = nodes.tgroup(cols=len(keep))
    group += [nodes.colspec(colwidth=widths[k]) for k in keep]

    def line(cells: Sequence[Sequence[nodes.Node] | str]) -> nodes.row:
        made = nodes.row()
        for k in keep:
            cell = cells[k]
            inside = inline(cell, None) if isinstance(cell, str) else list(cell)
            made += nodes.entry("", nodes.paragraph("", "", *inside))
        return made

    group += nodes.thead("", line(head))
    group += nodes.tbody("", *(line(row) for row in kept_rows))
    made = nodes.table("", group, classes=["reference-table"])
    return made


def wrapped(made: nodes.table) -> nodes.table:
    """A table whose first column has whole phrases: they may be broken into lines."""
    made["classes"].append("wrapped")
    return made


def code(text: str) -> list[nodes.Node]:
    return [nodes.literal(text, text)] if text else []


# --- block types -----------------------------------------------------------------------------------------------


def block_nodes(cls: Any) -> list[nodes.Node]:
    """All that is said about a block type."""
    d, names, interface = cls.declaration, names_of(cls), interface_of(cls)
    summary, pieces = pieces_of(cls)
    made: list[nodes.Node] = []
    if interface is not None:
        values = {
            n: p.default for n, p in d.parameters.items() if p.default is not REQUIRED and not callable(p.default)
        }
        made.append(raw(f'<div class="symbol-box">{symbol(cls.__name__, interface, values)}</div>'))
    made.append(paragraph(summary, names, display=True, style="summary"))
    made += body([piece for piece in pieces if not isinstance(piece, docstrings.References)], names)
    made += variable_tables(cls, interface)
    if d.requirements:
        made.append(nodes.rubric("", "Conditions"))
        items = [nodes.list_item("", nodes.paragraph("", requirement.message)) for requirement in d.requirements]
        made.append(nodes.bullet_list("", *items))
    instants = [f"{name} (crossing, {c.direction})" for name, c in d.crossings.items()]
    instants += [f"{name} (event time)" for name in d.event_times]
    if instants:
        text = nodes.Text(", ".join(instants))
        made.append(nodes.paragraph("", "", nodes.strong("", "Instants: "), text))
    made += body([piece for piece in pieces if isinstance(piece, docstrings.References)], names)
    return made


def variable_tables(cls: Any, interface: Interface | None) -> list[nodes.Node]:
    """Inputs, outputs, parameters, and what a run remembers of the block."""
    d = cls.declaration
    made: list[nodes.Node] = []

    def titled(title: str, head: Sequence[str], rows: list[Sequence[str]], widths: Sequence[int]) -> None:
        if rows:
            made.extend([nodes.rubric("", title), table(head, rows, widths)])

    four, widths = ("name", "unit", "default", "meaning"), (20, 15, 15, 50)
    titled("Inputs", four, [
        (ports_of(v, interface, "inputs"), unit_of(cls, v), default_of(v), meaning(v, size_of(v)))
        for v in d.inputs.values()
    ], widths)  # fmt: skip
    outputs = [*d.outputs.values(), *(v for v in (*d.states.values(), *d.discretes.values()) if v.output)]
    through = {} if interface is None else feedthrough(interface)

    def at_once(variable: Any) -> str:
        if getattr(variable, "wiring", False):
            return "wiring"
        return ", ".join(f"`{name}`" for name in through.get(variable.name, ()))

    titled("Outputs", ("name", "unit", "depends at once on", "meaning"), [
        (ports_of(v, interface, "outputs"), unit_of(cls, v), at_once(v),
         meaning(v, size_of(v), "sampled" if getattr(v, "clock", None) else ""))
        for v in outputs
    ], (20, 15, 20, 45))  # fmt: skip
    titled("Parameters", four, [
        (f"`{p.name}`", unit_of(cls, p), default_of(p), meaning(p, kind_of(p), range_of(p), size_of(p)))
        for p in d.settable.values()
    ], widths)  # fmt: skip
    titled("Memory", ("name", "unit", "start", "meaning"), [
        (f"`{v.name}`", unit_of(cls, v), f"`{v.name}_start`" if f"{v.name}_start" in d.parameters else "computed",
         meaning(v, kind, size_of(v)))
        for kind, group in (("state", d.states), ("discrete", d.discretes)) for v in group.values()
    ], widths)  # fmt: skip
    return made


def write_pages(folder: Path) -> None:
    """The pages of the library: one for each module."""
    folder.mkdir(exist_ok=True)
    wanted = {}
    for name, classes in modules().items():
        title, _ = module_texts(name)
        parts = [f"# {title}\n\n```{{module-text}} {name}\n```\n"]
        for cls in classes:
            label = f"block-{cls.__name__.lower()}"
            parts.append(f"({label})=\n## {cls.__name__}\n\n```{{block}} {cls.__name__}\n```\n")
        wanted[folder / f"{name}.md"] = "\n".join(parts)
    for path in folder.glob("*.md"):
        if path not in wanted:
            path.unlink()
    for path, text in wanted.items():
        # A page that stays as it was is not read again.
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


class Reference(SphinxDirective):
    """What these directives share: the page is made again when the code that it tells about changes."""

    def depend(self, *things: Any) -> None:
        for thing in (*things, raw, formulas.html, formula_tree.Node, docstrings.paragraphs_of, names_of, unit_of):
            self.env.note_dependency(str(Path(inspect.getfile(thing)).resolve()))


class BlockDirective(Reference):
    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        cls = LIBRARY.get(self.arguments[0])
        if cls is None:
            raise self.error(f"there is no block type {self.arguments[0]}")
        self.depend(cls, symbol)
        return block_nodes(cls)


class ModuleDirective(Reference):
    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        _, pieces = module_texts(self.arguments[0])
        self.depend(importlib.import_module(f"blocks.library.{self.arguments[0]}"))
        return body(pieces, NO_NAMES)


class LibraryDirective(Reference):
    def run(self) -> list[nodes.Node]:
        glance = [
            (
                [nodes.Text(module_texts(name)[0])],
                self.parse_inline(", ".join(f"[{cls.__name__}](#block-{cls.__name__.lower()})" for cls in classes))[0],
            )
            for name, classes in modules().items()
        ]
        made: list[nodes.Node] = [nodes.rubric("", "At a glance"), wrapped(table(("", "blocks"), glance, (25, 75)))]
        for name, classes in modules().items():
            title, _ = module_texts(name)
            rows = []
            for cls in classes:
                label = f"block-{cls.__name__.lower()}"
                summary = cls.declaration.doc.partition("\n")[0]
                link = self.parse_inline(f"[{cls.__name__}](#{label})")[0]
                rows.append((link, inline(summary, names_of(cls))))
            made += [nodes.rubric("", title), table(("block", "what it does"), rows, (25, 75))]
        return made


# --- commands, codes, tables -----------------------------------------------------------------------------------


def verbs() -> dict[str, argparse.ArgumentParser]:
    """The commands of `blocks`, by name; "fmu info" where one has commands of its own."""
    made: dict[str, argparse.ArgumentParser] = {}
    for name, parser in _commands(cli._parser()).items():
        own = _commands(parser)
        made |= {f"{name} {part}": inner for part, inner in own.items()} if own else {name: parser}
    return made


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return next((dict(a.choices) for a in parser._actions if isinstance(a, argparse._SubParsersAction)), {})


def usage_of(verb: str, parser: argparse.ArgumentParser) -> str:
    """A command with its arguments, and its options in brackets."""
    parts: list[str] = []
    places = 0
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction):
            continue
        if action.option_strings:
            value = f" {action.metavar or action.dest.upper()}" if action.nargs != 0 else ""
            parts.append(f"[{action.option_strings[-1]}{value}]")
        else:
            shown = str(action.metavar or action.dest)
            optional = action.nargs in ("?", "*")
            more = " ..." if action.nargs in ("*", "+") else ""
            parts.insert(places, f"[{shown}{more}]" if optional else f"{shown}{more}")
            places += 1
    return f"blocks {verb} {' '.join(parts)}"


class CommandsDirective(Reference):
    def run(self) -> list[nodes.Node]:
        self.depend(cli.main)
        glance = []
        for verb, parser in verbs().items():
            told = re.split(r"(?<=[.:;])\s", parser.description or "")[0].rstrip(".:;")
            place = f"blocks-{verb.replace(' ', '-')}"
            link = nodes.reference("", "", *code(f"blocks {verb}"), refid=place, internal=True)
            glance.append(([link], inline(told, None)))
        made: list[nodes.Node] = [table(("command", "what it does"), glance, (30, 70))]
        for verb, parser in verbs().items():
            made.append(self.section(verb, parser))
        return made

    def section(self, verb: str, parser: argparse.ArgumentParser) -> nodes.Node:
        section = nodes.section(ids=[f"blocks-{verb.replace(' ', '-')}"], names=[f"blocks {verb}"])
        section += nodes.title("", f"blocks {verb}")
        section += paragraph(parser.description or "", None)
        text = usage_of(verb, parser)
        section += nodes.literal_block(text, text, language="output", classes=["usage"])
        rows = []
        for action in parser._actions:
            if isinstance(action, argparse._HelpAction):
                continue
            value = f" {action.metavar or action.dest.upper()}" if action.nargs != 0 else ""
            shown = ", ".join(f"{option}{value}" for option in action.option_strings) or str(action.metavar)
            text = (action.help or "").replace("%%", "%")
            rows.append((code(shown), inline(text, None)))
        section += table(("argument", "meaning"), rows, (35, 65))
        self.state.document.note_explicit_target(section, section)
        return section


class CodesDirective(Reference):
    def run(self) -> list[nodes.Node]:
        self.depend(explained)
        for path in FOLDER.glob("*.md"):
            self.env.note_dependency(str(path))
        made: list[nodes.Node] = []
        for group in GROUPS:
            section = nodes.section(ids=[f"codes-{group.prefix.lower()}"], names=[f"codes {group.prefix.lower()}"])
            title = group.title if group.title[:3] == "FMU" else group.title[0].lower() + group.title[1:]
            section += nodes.title("", f"{group.prefix}xx: {title}")
            section += paragraph(group.ends, None)
            self.state.document.note_explicit_target(section, section)
            section += [self.code(code) for code in group.codes]
            made.append(section)
        return made

    def code(self, code: str) -> nodes.section:
        """A code with its cause, its cure, and its example, which opens where it is asked for."""
        explanation = EXPLAINED[code]
        section = nodes.section(ids=[code.lower()], names=[code.lower()], classes=["code"])
        section += nodes.title("", f"{code}: {explanation.title}")
        section += paragraph(explanation.cause, None)
        cure = paragraph(explanation.cure, None, style="cure")
        cure.insert(0, nodes.strong("", "What to do: "))
        section += cure
        example = explanation.example
        section += raw("<details><summary>Example</summary>")
        if example.given:
            section += paragraph(f"With {example.given}:", None)
        for name, text in example.texts:
            classes = [] if name else ["said"]
            section += nodes.literal_block(text, text, language=language_of(name, text), classes=classes)
            if name:
                section[-1] = nodes.container("", caption(name), section[-1], literal_block=True)
        section += raw("</details>")
        self.state.document.note_explicit_target(section, section)
        return section


def caption(text: str) -> nodes.caption:
    return nodes.caption("", "", nodes.literal(text, text))


def language_of(name: str, text: str) -> str:
    """By which a text is coloured. Not every file of an example is what its name says: that may be what is wrong."""
    if name.endswith(".py"):
        return "python"
    try:
        json.loads(text)
    except ValueError:
        return "output"
    return "json"


class KeysDirective(Reference):
    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        kind = {**vars(study_grammar), **vars(diagram_grammar)}[name]
        for grammar in (study_grammar, diagram_grammar):
            self.env.note_dependency(str(grammar.__file__))
        more = dict(line.split(": ", 1) for line in self.content)
        if unknown := [key for key in more if key not in kind.keys]:
            raise self.error(f"{name} has no {unknown[0]}")
        rows = []
        for field in kind.fields:
            choices = f"{field.kind.what}. " if isinstance(field.kind, Choice) else ""
            told = inline(choices + (field.doc or field.kind.doc), None)
            told += [nodes.Text(" "), *self.parse_inline(more[field.key])[0]] if field.key in more else []
            default = code("" if field.default is None else json.dumps(field.default))
            if isinstance(field.kind, Constant):
                default = code(" or ".join(json.dumps(value) for value in field.kind.values))
            rows.append((code(field.key), told, "must be given" if field.required and not default else default))
        return [table(("key", "meaning", "default"), rows, (20, 60, 20))]


class MeasuresDirective(Reference):
    def run(self) -> list[nodes.Node]:
        return [table(("type", "value"), [(code(name), inline(doc, None)) for name, doc in MEASURES.items()], (25, 75))]


class SimulinkWordsDirective(Reference):
    def run(self) -> list[nodes.Node]:
        path = Path(blocks.__file__).resolve().parent / "model" / "simulink_words.json"
        self.env.note_dependency(str(path))
        told: dict[tuple[str, ...], list[str]] = {}
        for word, entry in json.loads(path.read_text(encoding="utf-8")).items():
            told.setdefault((entry["here"], entry["see"], *entry["blocks"]), []).append(word)
        rows = []
        for (here, see, *types), words in told.items():
            linked = [f"[{name}](#block-{name.lower()})" for name in types]
            place, _, anchor = see.partition("#")
            name = (anchor.replace("-", " ") or place.removesuffix(".md").replace("_", " ")).capitalize()
            more = [] if place == "library.md" else [f"[{name}]({see})"]
            rows.append((", ".join(words), inline(here, None), self.parse_inline(", ".join([*linked, *more]))[0]))
        return [wrapped(table(("in Simulink", "here", "see"), rows, (25, 50, 25)))]


class UnitsDirective(Reference):
    def run(self) -> list[nodes.Node]:
        rows: list[tuple[Any, ...]] = [("base units", code(" ".join(units.BASE)), "")]
        rows.append(("named units", code(" ".join(units._NAMED)), "with prefixes"))
        scaled = {name: takes for name, (*_, takes) in units._SCALED.items()}
        rows.append(("other units", code(" ".join(name for name, takes in scaled.items() if takes)), "with prefixes"))
        rows.append(("", code(" ".join(name for name, takes in scaled.items() if not takes)), "without prefixes"))
        rows.append(("with an offset", code(" ".join(units._ALONE)), "alone, without prefixes"))
        rows.append(("prefixes", code(" ".join(units._PREFIXES)), ""))
        return [table(("what", "symbols", ""), rows, (20, 55, 25))]


class FunctionsDirective(Reference):
    """The functions of numpy that equations may use."""

    def run(self) -> list[nodes.Node]:
        from blocks.contract import symbols

        self.depend(symbols.symbol)
        names = {f.__name__ for f in symbols._UFUNCS} | {f.__name__ for f in symbols._FUNCTIONS}
        operators = {"add", "subtract", "multiply", "divide", "negative", "positive", "less", "less_equal", "greater"}
        operators |= {"greater_equal", "equal", "not_equal", "bitwise_and", "bitwise_or", "bitwise_xor", "invert"}
        aliases = {"absolute": "abs", "norm": "linalg.norm", "amax": "max", "amin": "min"}
        shown = sorted(aliases.get(name, name) for name in names - operators)
        made: list[nodes.Node] = []
        for name in shown:
            made += [*([nodes.Text(", ")] if made else []), nodes.literal(name, name)]
        return [nodes.paragraph("", "", *made, classes=["functions"])]


# --- Python ----------------------------------------------------------------------------------------------------


def signature_of(thing: Any) -> str:
    """Names, types and defaults of the arguments, without self."""
    try:
        signature = inspect.signature(thing)
    except (TypeError, ValueError):
        return "()"
    kept = [p for p in signature.parameters.values() if p.name not in ("self", "cls")]
    text = str(signature.replace(parameters=kept))
    # `from __future__ import annotations` leaves annotations as texts.
    text = re.sub(r"(: |-> )'([^']*)'", r"\1\2", text).replace("REQUIRED", "...")
    return re.sub(r" -> .*", "", text) if inspect.isclass(thing) else text


def members_of(thing: type) -> Iterator[tuple[str, Any]]:
    """Public functions and properties of a class and of those of ours that it stands on, these first."""
    ours = [cls for cls in reversed(thing.__mro__) if cls.__module__.split(".")[0] == "blocks"]
    told = {key: member for cls in ours for key, member in vars(cls).items() if not key.startswith("_")}
    kinds = (property, classmethod, staticmethod)
    return ((key, one) for key, one in told.items() if inspect.isfunction(one) or isinstance(one, kinds))


class PythonDirective(Reference):
    """A public name: a class with its public methods, a function, or an exception."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        places = (blocks.analysis, blocks.graph, blocks)
        thing = next(getattr(place, name) for place in places if name in place.__all__)
        self.depend(thing)
        kind = "class" if inspect.isclass(thing) else "function"
        if inspect.isclass(thing) and issubclass(thing, BaseException):
            kind = "exception"
        signature = "" if kind == "exception" else signature_of(thing)
        made, content = self.described(kind, f"{name}{signature}")
        content += body(docstrings.paragraphs_of(inspect.getdoc(thing) or ""), None)
        if kind == "class":
            for key, member in members_of(thing):
                content += self.member(name, key, member)
        return made

    def member(self, owner: str, key: str, member: Any) -> list[nodes.Node]:
        if isinstance(member, property):
            made, content = self.described("attribute", f"{owner}.{key}")
            content += body(docstrings.paragraphs_of(inspect.getdoc(member.fget) or ""), None)
            return made
        kind = "classmethod" if isinstance(member, classmethod) else "method"
        function = member.__func__ if isinstance(member, (classmethod, staticmethod)) else member
        made, content = self.described(kind, f"{owner}.{key}{signature_of(function)}")
        content += body(docstrings.paragraphs_of(inspect.getdoc(function) or ""), None)
        return made

    def described(self, kind: str, signature: str) -> tuple[list[nodes.Node], addnodes.desc_content]:
        """A description of Sphinx's Python domain, and the place of its text."""
        made = self.parse_text_to_nodes(f"```{{py:{kind}}} {signature}\n```")
        content = next(iter(node for top in made for node in top.findall(addnodes.desc_content)))
        return made, content


# --- diagrams --------------------------------------------------------------------------------------------------


class DrawingDirective(Reference):
    """A diagram, drawn from its file."""

    required_arguments = 1
    option_spec = {"depth": int, "caption": str}  # noqa: RUF012

    def run(self) -> list[nodes.Node]:
        from blocks.api.diagram import Diagram

        path = ROOT / self.arguments[0]
        self.env.note_dependency(str(path))
        svg = Diagram.load(path).draw(depth=self.options.get("depth", 1))
        figure = nodes.figure("", raw(re.sub(r"<style>.*?</style>", "", svg, flags=re.DOTALL)), classes=["drawing"])
        if "caption" in self.options:
            figure += nodes.caption("", "", *inline(self.options["caption"], None))
        return [figure]


class PlotDirective(Reference):
    """Signals of a run, plotted; or the `figure` that lines of Python make of `diagram`."""

    required_arguments = 1
    has_content = True
    option_spec = {"signals": str, "set": str, "caption": str}  # noqa: RUF012

    def run(self) -> list[nodes.Node]:
        self.env.note_dependency(str(ROOT / self.arguments[0]))
        figure = plotted(self.arguments[0], self.options, "\n".join(self.content))
        made = nodes.figure("", raw(svg_of(figure)), classes=["plot"])
        if "caption" in self.options:
            made += nodes.caption("", "", *inline(self.options["caption"], None))
        return [made]


def plotted(file: str, options: Mapping[str, str], code: str = "") -> Any:
    """The matplotlib figure of a {plot}, without a title: the caption says what it is."""
    from blocks.api.diagram import Diagram

    diagram = Diagram.load(ROOT / file)
    if code:
        names: dict[str, Any] = {"diagram": diagram}
        exec(compile(code, file, "exec"), names)
        figure = names["figure"]
    else:
        parameters = assignments("--set", shlex.split(options.get("set", "")), "motor.Ra=200 mOhm")
        figure = diagram.run(parameters=parameters).plot(*shlex.split(options.get("signals", "")))
    figure.suptitle("")
    return figure


def svg_of(figure: Any) -> str:
    from blocks.results import plots

    svg = plots.svg_text(figure)
    return svg[svg.index("<svg") :]


class CardsDirective(Reference):
    """Cards that lead to pages of this folder, which are named a line each."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        self.assert_has_content()
        return [raw(f'<div class="cards">{"".join(self.card(name) for name in self.content)}</div>')]

    def card(self, name: str) -> str:
        docname = f"{self.env.docname.rpartition('/')[0]}/{name}"
        path = Path(self.env.doc2path(docname))
        self.env.note_dependency(str(path))
        text = path.read_text(encoding="utf-8")
        title, question = (part.strip() for part in text.split("\n\n")[:2])
        plot = re.search(r"^```\{plot\} (\S+)\n((?::.*\n)*)((?:.*\n)*?)```$", text, re.MULTILINE)
        assert plot is not None, f"{path}: a card shows the first plot of its page"
        self.env.note_dependency(str(ROOT / plot[1]))
        picture = small(plotted(plot[1], dict(re.findall(r"^:(\w+): *(.*)$", plot[2], re.MULTILINE)), plot[3]))
        link = self.env.app.builder.get_relative_uri(self.env.docname, docname)
        told = escape(" ".join(question.split()))
        return f'<a class="card" href="{link}">{picture}<b>{escape(title.lstrip("# "))}</b><span>{told}</span></a>'


def small(figure: Any) -> str:
    """The curves of a figure, without words and numbers."""
    figure.set_size_inches(3.6, 2.2)
    figure.supxlabel("")
    for legend in [*figure.legends]:
        legend.remove()
    for axes in figure.axes:
        axes.set(title="", xlabel="", ylabel="", xticklabels=[], yticklabels=[])
        axes.tick_params(length=0)
        axes.spines[:].set_alpha(0.4)
        for text in [*axes.texts, *([axes.get_legend()] if axes.get_legend() else [])]:
            text.remove()
    svg = svg_of(figure)
    return re.sub(r'<g id="[^"]*"', "<g", svg).replace("<svg ", '<svg aria-hidden="true" ', 1)


def begin(app: Sphinx) -> None:
    write_pages(Path(app.srcdir) / "library")


def add_style(app: Sphinx, config: Any) -> None:
    """The style sheet of drawings, made by the code that draws."""
    # Below the folder of the pages Sphinx would not copy it, and the doctrees are there unless -d says otherwise.
    folder = Path(f"{app.outdir}-made")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "drawings.css").write_text(style_sheet(), encoding="utf-8")
    config.html_static_path.append(str(folder))


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("config-inited", add_style)
    app.connect("builder-inited", begin)
    app.add_css_file("drawings.css")
    app.add_lexer("output", TextLexer)
    app.add_lexer("csv", TextLexer)
    for name, directive in {
        "block": BlockDirective,
        "cards": CardsDirective,
        "codes": CodesDirective,
        "commands": CommandsDirective,
        "drawing": DrawingDirective,
        "functions": FunctionsDirective,
        "keys": KeysDirective,
        "library": LibraryDirective,
        "measures": MeasuresDirective,
        "module-text": ModuleDirective,
        "plot": PlotDirective,
        "python": PythonDirective,
        "simulink-words": SimulinkWordsDirective,
        "units": UnitsDirective,
    }.items():
        app.add_directive(name, directive)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
