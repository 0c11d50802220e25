"""Below the Plan nobody knows a block: what engines and the C of a Plan need of a block stands in the Plan as data."""

import ast
from pathlib import Path

import pytest

BLOCKS = Path(__file__).resolve().parents[2] / "blocks"
PLACES = (
    *("engines", "engines/master", "engines/native", "engines/reference", "engines/run", "compile/c"),
    *("compile/inputs.py", "compile/jacobian.py", "compile/motion.py", "compile/plan.py", "compile/scheduler.py"),
    *("compile/tick_stages.py", "compile/time_grid.py"),
    "export/tables_code.py",
)
FILES = sorted(
    path
    for place in PLACES
    for path in ([BLOCKS / place] if place.endswith(".py") else (BLOCKS / place).glob("*.py"))
    if path.name != "prepared.py"  # which makes the Plan
)
DECLARING = (
    *(f"contract.{name}" for name in ("block", "class_body", "declaration", "equations", "interface", "variables")),
    "model.flatten",
)


def imported(tree: ast.AST) -> set[str]:
    """The modules that a module imports, and what it imports from them, without the dots in front."""
    made: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            made |= {node.module or "", *(f"{node.module}.{name.name}" for name in node.names)}
        elif isinstance(node, ast.Import):
            made |= {name.name.removeprefix("blocks.") for name in node.names}
    return made


def reads(tree: ast.AST) -> list[str]:
    """Reads of the declaration or the interface of a block. What an FMU offers is an interface too: of a `foreign`."""
    made = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in ("declaration", "interface"):
            owner = ast.unparse(node.value)
            if node.attr == "declaration" or not owner.endswith(("foreign", "self", "unit", "running")):
                made.append(f"line {node.lineno}: {ast.unparse(node)}")
    return made


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(BLOCKS)))
def test_below_the_plan_nobody_knows_a_block(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert not [name for name in imported(tree) if name in DECLARING]
    assert reads(tree) == []


@pytest.mark.parametrize("path", sorted((BLOCKS / "linear").glob("*.py")), ids=lambda path: path.name)
def test_linear_models_know_ports_and_equations_and_no_class_body(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert not [name for name in imported(tree) if name in DECLARING]
    assert not [read for read in reads(tree) if read.endswith(".declaration") or ".declaration." in read]


def test_a_read_of_a_block_would_be_found() -> None:
    tree = ast.parse("from ...contract import declaration\na = plan.instances[0].tape.interface.declaration.states\n")
    assert "contract.declaration" in imported(tree)
    assert len(reads(tree)) == 2
    assert reads(ast.parse("can = part.foreign.interface.saves")) == []
