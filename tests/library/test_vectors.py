"""Sparse couplings, switched ones, and reductions of long vectors: against NumPy, SciPy and the same written out."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from blocks import (
    Block,
    CompareToConstant,
    Diagram,
    DotProduct,
    Gain,
    Input,
    Integrator,
    MatrixGain,
    ModelError,
    MultiportSwitch,
    Mux,
    Norm,
    Parameter,
    Reduction,
    Sine,
    StateSpace,
    Sum,
    SwitchedMatrixGain,
    UsageError,
    graph,
    output,
    subdiagram,
)
from blocks.compile.c.model_code import emit
from blocks.compile.coupling import Coupling, couple
from blocks.compile.plan import Plan
from blocks.model import parts
from tests.support.fmus import exported

Array = np.ndarray[Any, Any]
FIXED = {"method": "rk4", "step": 0.01}


def matrix(rows: int, columns: int, density: float, seed: int = 1) -> Array:
    """A random matrix of this density; its first row is full, its second one empty."""
    rng = np.random.default_rng(seed)
    dense = np.where(rng.uniform(size=(rows, columns)) < density, rng.normal(size=(rows, columns)), 0.0)
    dense[0], dense[1] = rng.normal(size=columns), 0.0
    return dense


def agents(coupling: Block, start: Array) -> Diagram:
    """dx/dt = what a block gives of x."""
    d, n = Diagram("agents"), len(start)
    mux, gain = d.add("mux", Mux(size=n)), d.add("gain", coupling)
    d.wire(gain.u, mux.y)
    for k, value in enumerate(start):
        agent = d.add(f"x{k}", Integrator(y_start=float(value)))
        d.wire(agent.u, gain.y[k])
        d.wire(f"mux.u{k + 1}", agent.y)
    return d


def waves(size: int) -> Diagram:
    """A vector u of waves that differ."""
    d = Diagram("waves")
    d.add("u", Mux(size=size))
    for k in range(size):
        d.wire(f"u.u{k + 1}", d.add(f"s{k}", Sine(amplitude=1.0 + k % 5, omega=1.0 + 0.37 * k, phase=0.2 * k)).y)
    return d


@pytest.mark.parametrize("engine", ["native", "reference"])
@pytest.mark.parametrize("settings", [{"method": "euler", "step": 0.01}, FIXED, {"method": "dopri5"}], ids=str)
def test_a_sparse_gain_gives_the_bits_of_the_dense_one(settings: dict[str, Any], engine: str) -> None:
    n = 40  # more than a link of a chain takes
    K, start = 0.3 * matrix(n, n, 0.1), np.random.default_rng(2).normal(size=n)
    runs = [agents(MatrixGain(K=k), start).run(stop=1, engine=engine, **settings) for k in (K, sp.csr_array(K))]
    assert list(runs[0]) == list(runs[1])
    for name in runs[0]:
        assert np.array_equal(runs[0][name], runs[1][name]), name
    x = np.column_stack([runs[1][f"x{k}.y"] for k in range(n)])
    assert np.asarray(runs[1]["gain.y"]) == pytest.approx(x @ K.T, rel=1e-12, abs=1e-12)


def test_a_sparse_gain_is_the_sum_written_out() -> None:
    start = np.array([0.3, -0.7, 0.11])
    written = Diagram("agents")
    for k, value in enumerate(start):
        agent, total = written.add(f"x{k}", Integrator(y_start=value)), written.add(f"sum{k}", Sum(signs="++"))
        written.wire(agent.u, total.y)
    for k in range(3):
        for port, (column, value) in enumerate([(k, -0.9), ((k + 1) % 3, 0.7)] if k < 2 else [(0, 0.7), (2, -0.9)]):
            gain = written.add(f"k{k}{column}", Gain(k=value))
            written.wire(gain.u, f"x{column}.y")
            written.wire(f"sum{k}.u{port + 1}", gain.y)
    K = 0.7 * graph.ring(3, directed=True).T - 0.9 * sp.eye_array(3)
    for engine in ("native", "reference"):
        runs = [d.run(stop=2, engine=engine, **FIXED) for d in (agents(MatrixGain(K=K), start), written)]
        assert all(np.array_equal(runs[0][f"x{k}.y"], runs[1][f"x{k}.y"]) for k in range(3))


def test_an_element_depends_only_on_what_its_row_holds() -> None:
    # A chain through one gain, each element from the one before: no algebraic loop, as K lies below the diagonal.
    K = graph.line(20, directed=True) * 0.5
    d = Diagram("chain")
    mux, gain = d.add("mux", Mux(size=20)), d.add("gain", MatrixGain(K=K))
    d.wire(gain.u, mux.y)
    d.wire("mux.u1", d.input("u", default=1.0))
    for k in range(1, 20):
        d.wire(f"mux.u{k + 1}", f"gain.y[{k}]")
    assert d.run(stop=0.1)["gain.y"][-1].tolist() == [0.0] + [0.5**k for k in range(1, 20)]
    closed = Diagram("closed")
    mux, gain = closed.add("mux", Mux(size=4)), closed.add("gain", MatrixGain(K=graph.ring(4, directed=True)))
    closed.wire(gain.u, mux.y)
    for k in range(4):
        closed.wire(f"mux.u{k + 1}", f"gain.y[{k}]")
    with pytest.raises(ModelError, match="E102"):
        closed.check()


def test_the_linear_model_is_the_matrix() -> None:
    K = matrix(24, 24, 0.2)
    d = agents(MatrixGain(K=sp.csr_array(K)), np.zeros(24))
    names = [f"x{k}.y" for k in range(24)]
    assert np.array_equal(d.linearize(names, "gain.y").D, K)
    assert np.array_equal(d.linearize(names, ["gain.y[0]", "gain.y[5]"]).D, K[[0, 5]])
    closed = d.linearize("x0.u", names)  # all but the second agent, which nothing moves
    others = [k for k in range(24) if k != 1]
    assert np.sort_complex(closed.poles()) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(K[np.ix_(others, others)])), abs=1e-9
    )


@pytest.mark.parametrize(
    ("adjacency", "second"),
    [
        (graph.ring(12), 2 - 2 * math.cos(2 * math.pi / 12)),
        (graph.line(12), 2 - 2 * math.cos(math.pi / 12)),
        (graph.grid(3, 5), 2 - 2 * math.cos(math.pi / 5)),
        (graph.random_geometric(30, 0.4, seed=4), None),
    ],
    ids=["ring", "line", "grid", "random"],
)
def test_agents_agree_at_the_rate_of_the_second_eigenvalue(adjacency: Any, second: float | None) -> None:
    laplacian = graph.laplacian(adjacency)
    values, vectors = np.linalg.eigh(laplacian.toarray())
    assert second is None or values[1] == pytest.approx(second, abs=1e-12)
    start = 1.0 + vectors[:, 1] + 0.3 * vectors[:, -1]
    d = agents(MatrixGain(K=-laplacian), start)
    mean, spread = (
        d.add("mean", Reduction(size=len(start))),
        d.add("spread", Reduction(kind="deviation", size=len(start))),
    )
    d.wire(mean.u, "mux.y")
    d.wire(spread.u, "mux.y")
    stop = 20.0 / values[-1]
    results = d.run(stop=stop, rtol=1e-10, atol=1e-13, log=["mean.y", "spread.y"])
    assert np.asarray(results["mean.y"]) == pytest.approx(np.mean(start), abs=1e-12)
    late = np.asarray(results.t) > 0.8 * stop
    slope = np.polyfit(results.t[late], np.log(results["spread.y"][late]), 1)[0]
    assert slope == pytest.approx(-values[1], rel=1e-4)


def test_graphs_are_what_they_are_called() -> None:
    assert graph.ring(4).toarray().tolist() == [[0, 1, 0, 1], [1, 0, 1, 0], [0, 1, 0, 1], [1, 0, 1, 0]]
    assert graph.line(3, directed=True).toarray().tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert graph.grid(2, 3).sum(axis=1).tolist() == [2, 3, 2, 2, 3, 2]
    near = graph.random_geometric(50, 0.2, seed=7).toarray()
    places = np.random.default_rng(7).uniform(size=(50, 2))
    distances = np.hypot(*(places[:, None] - places).T)
    assert np.array_equal(near != 0, (distances <= 0.2) & ~np.eye(50, dtype=bool))
    assert not np.array_equal(near, graph.random_geometric(50, 0.2, seed=8).toarray())
    assert graph.laplacian([[0, 2], [0, 0]]).toarray().tolist() == [[2, -2], [0, 0]]
    for wrong in (lambda: graph.ring(2), lambda: graph.laplacian(np.ones((2, 3))), lambda: graph.line(0)):
        with pytest.raises(ModelError, match="E110 graph"):
            wrong()


# --- files -----------------------------------------------------------------------------------------------------


def loaded(folder: Path, document: Any) -> Diagram:
    path = folder / "net.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return Diagram.load(path)


def of_file(folder: Path, K: Any, **more: Any) -> Diagram:
    block = {"type": "MatrixGain", "parameters": {"K": K}}
    document = {
        "format": "blocks-diagram",
        "version": 3,
        "inputs": {"u": {"size": 3}},
        "blocks": {"gain": block},
        **more,
    }
    return loaded(folder, {**document, "wires": {"gain.u": "u"}})


def test_edges_in_a_file_in_a_csv_file_and_of_scipy_are_one_matrix(tmp_path: Path) -> None:
    edges = [[0, 0, 2], [0, 2, -1.5], [1, 2, 300.0]]
    (tmp_path / "net.csv").write_text("row,column,value\n" + "\n".join(f"{i},{j},{w}" for i, j, w in edges), "utf-8")
    forms = [
        {"edges": edges, "shape": [2, 3]},
        {"edges": [[1, 2, 300000], [0, 2, -1500], [0, 0, 2000]], "shape": [2, 3], "unit": "mm/s"},
        {"csv": "net.csv", "shape": [2, 3]},
        "=net",
    ]
    for K in forms:
        d = of_file(tmp_path, K, parameters={"net": forms[0]})
        document = json.loads(d.dumps())
        document["blocks"]["gain"]["parameters"] |= {"unit": "m/s", "unit_u": "1"}
        d = loaded(tmp_path, document)
        assert d.run(stop=1, inputs={"u": [1.0, 2.0, 3.0]})["gain.y"][-1].tolist() == [-2.5, 900.0]
        assert d.dumps() == Diagram.load(tmp_path / "net.json").dumps()
    d = Diagram("net")
    gain = d.add(
        "gain", MatrixGain(K=sp.coo_array(([1.0, 1.0, -1.5, 300.0], ([0, 0, 0, 1], [0, 0, 2, 2])), shape=(2, 3)))
    )
    assert json.loads(d.dumps())["blocks"]["gain"]["parameters"]["K"] == {
        "edges": [[0, 0, 2.0], [0, 2, -1.5], [1, 2, 300.0]], "shape": [2, 3]
    }  # fmt: skip
    d.wire(gain.u, d.input("u", size=3))
    d.save(tmp_path / "made.json")
    assert Diagram.load(tmp_path / "made.json").dumps() == d.dumps()


@pytest.mark.parametrize(
    ("K", "message"),
    [
        (
            {"edges": [[0, 0, 1], [2, 1, 1]], "shape": [2, 3]},
            r"E107 .*gain.K: the edge \[2, 1, 1\] \(number 1\) is outside",
        ),
        ({"edges": [[0, -1, 1]], "shape": [2, 3]}, r"E107 .*\[0, -1, 1\] \(number 0\) is outside"),
        ({"edges": [[0, 0.5, 1]], "shape": [2, 3]}, r"E107 .*must begin with two integers"),
        (
            {"edges": [[0, 1, 1], [1, 1, 1], [0, 1, 4]], "shape": [2, 3]},
            r"E107 .*\[0, 1, 4\] \(number 2\) appears twice",
        ),
        (
            {"edges": [[0, 1]], "shape": [2, 3]},
            r"E004 .*gain.parameters.K.edges.0: must be an edge \[row, column, value\]",
        ),
        ({"edges": [[0, 1, "=k"]], "shape": [2, 3]}, r"E004 .*K.edges.0.2: must be a number"),
        ({"edges": [[0, 1, 1]]}, r'E00.*"shape" is missing|E009'),
        ({"edges": [], "csv": "a.csv", "shape": [2, 3]}, r'E009 .*needs either "edges" or "csv"'),
        ({"edges": [], "shape": [2]}, r"E004 .*K.shape: must be two sizes"),
        ({"edges": [], "shape": [2, 4]}, "E110"),
        ({"csv": "missing.csv", "shape": [2, 3]}, r"E007 .*missing.csv"),
        ({"csv": "bad.csv", "shape": [2, 3]}, r"E007 .*has no column \"value\""),
        ({"csv": "nan.csv", "shape": [2, 3]}, r"E107 .*\[1, 1, nan\] \(number 0\) must have finite numbers"),
    ],
    ids=lambda value: None if isinstance(value, str) else json.dumps(value)[:40],
)
def test_wrong_edges_are_refused_where_they_stand(tmp_path: Path, K: Any, message: str) -> None:
    (tmp_path / "bad.csv").write_text("row,column,weight\n1,1,1\n", encoding="utf-8")
    (tmp_path / "nan.csv").write_text("row,column,value\n1,1,nan\n", encoding="utf-8")
    with pytest.raises(ModelError, match=message) as caught:
        of_file(tmp_path, K).check()
    assert all(fault.line for fault in caught.value.faults)


class Half(Block):
    """y = K u / 2."""

    K = Parameter([[1.0]], shape=("p", "m"), zeros=True, sparse=True)
    u = Input(shape=lambda m: m)

    @output(shape=lambda p: p)
    def y(u, K):
        return K @ u / 2


def test_other_matrices_are_filled_up_or_refused() -> None:
    d = Diagram("plant")
    plant = d.add("plant", StateSpace(A=-graph.laplacian(graph.line(3)), B=[[1], [0], [0]], C=sp.eye_array(3)))
    d.wire(plant.u, d.input("u", size=1))
    assert d.linearize("u", "plant.y").A.tolist() == [[-1, 1, 0], [1, -2, 1], [0, 1, -1]]
    wrong = Diagram("wrong")
    half = wrong.add("half", Half(K=sp.eye_array(2)))
    wrong.wire(half.u, wrong.input("u", size=2))
    with pytest.raises(ModelError, match=r"E107 half\.K: is sparse, but the block type Half cannot"):
        wrong.check()
    for K, message in (
        (sp.eye_array(2000), "is 2000 x 2000, and all of its elements"),
        (sp.eye_array(3), "cannot be a sparse matrix"),
    ):
        with pytest.raises(ModelError, match=message):
            Diagram("wrong").add("b", StateSpace(A=K, B=[[1]], C=[[1]]) if K.shape[0] > 3 else Gain(k=K))


# --- the cost --------------------------------------------------------------------------------------------------


def printed(n: int) -> tuple[int, int]:
    """The functions and the loops of the C of a ring."""
    plan = agents(MatrixGain(K=-graph.laplacian(graph.ring(n))), np.zeros(n)).check()
    assert isinstance(plan, Plan)
    source = emit(plan, method="rk4").source
    return source.count("\nstatic inline double f"), source.count("for (int i = 0;")


def test_equal_rows_are_lanes_of_one_loop() -> None:
    assert printed(100) == printed(400)


# --- couplings that change -------------------------------------------------------------------------------------


def switched(K: Any, index: Any, start: Array) -> Diagram:
    d = agents(SwitchedMatrixGain(K=K, size=2), start)
    d.wire("gain.index", d.add("index", index).y)
    return d


@pytest.mark.parametrize("engine", ["native", "reference"])
def test_a_switched_gain_is_the_multiport_switch_of_two_gains(engine: str) -> None:
    first, second = -graph.laplacian(graph.ring(5)), 0.4 * sp.csr_array(matrix(5, 5, 0.5))
    start, index = np.arange(5.0), Sine(amplitude=0.9, bias=1.5, omega=3.0)
    stacked = sp.vstack([first, second])
    written = Diagram("written")
    mux = written.add("mux", Mux(size=5))
    signal = written.add("index", index)
    for name, K in (("g1", first), ("g2", second)):
        written.wire(written.add(name, MatrixGain(K=K.toarray())).u, mux.y)
    for k in range(5):
        switch, agent = (
            written.add(f"s{k}", MultiportSwitch(size=2)),
            written.add(f"x{k}", Integrator(y_start=start[k])),
        )
        for port in (1, 2):
            written.wire(f"s{k}.u{port}", f"g{port}.y[{k}]")
        written.wire(switch.index, signal.y)
        written.wire(agent.u, switch.y)
        written.wire(f"mux.u{k + 1}", agent.y)
    runs = [d.run(stop=3, engine=engine, **FIXED) for d in (switched(stacked, index, start), written)]
    runs.append(switched(stacked.toarray(), index, start).run(stop=3, engine=engine, **FIXED))
    located = [event.t for event in runs[1].events if event.block == "s0"]
    assert len(located) == 2
    for run in (runs[0], runs[2]):
        assert [(event.t, event.block) for event in run.events] == [(t, "gain") for t in located]
        assert all(np.array_equal(run[f"x{k}.y"], runs[1][f"x{k}.y"]) for k in range(5))


def test_a_switched_gain_refuses_rows_that_do_not_divide() -> None:
    with pytest.raises(ModelError, match=r"E107 .*gain: the rows of K must be those of `size` matrices"):
        switched(np.ones((5, 2)), Sine(), np.zeros(2)).check()


# --- reductions ------------------------------------------------------------------------------------------------

REDUCED: dict[str, tuple[Block, Any]] = {
    **{
        kind: (Reduction(kind=kind, size=100), value)
        for kind, value in (("mean", np.mean), ("sum", np.sum), ("min", np.min), ("max", np.max), ("deviation", np.std))
    },
    "2": (Norm(kind="2", size=100), np.linalg.norm),
    "1": (Norm(kind="1", size=100), lambda u, axis: np.linalg.norm(u, 1, axis)),
    "inf": (Norm(kind="inf", size=100), lambda u, axis: np.linalg.norm(u, np.inf, axis)),
    "dot": (DotProduct(size=100), lambda u, axis: np.sum(u * u, axis)),
}  # fmt: skip


@pytest.mark.parametrize("kind", REDUCED)
def test_long_reductions_are_those_of_numpy_and_of_the_equations(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    block, value = REDUCED[kind]
    runs = []
    for longest in (64, 1000):
        monkeypatch.setattr(parts, "LONGEST", longest)
        d = waves(100)
        reduced = d.add("reduced", block)
        for port in ("u1", "u2") if kind == "dot" else ("u",):
            d.wire(getattr(reduced, port), "u.y")
        runs += [d.run(stop=1, every=0.1, engine=engine) for engine in ("native", "reference")]
    assert np.asarray(runs[0]["reduced.y"]) == pytest.approx(value(np.asarray(runs[0]["u.y"]), axis=1), rel=1e-12)
    assert all(np.array_equal(run["reduced.y"], runs[0]["reduced.y"]) for run in runs[1:])


@pytest.mark.parametrize("kind", ["mean", "sum", "min", "max", "deviation"])
def test_short_reductions_are_those_of_numpy(kind: str) -> None:
    d = waves(5)
    d.wire(d.add("reduced", Reduction(kind=kind, size=5)).u, "u.y")
    results = d.run(stop=1, every=0.1)
    assert np.asarray(results["reduced.y"]) == pytest.approx(REDUCED[kind][1](np.asarray(results["u.y"]), axis=1))


# --- where blocks stand ----------------------------------------------------------------------------------------


def test_a_sparse_gain_in_a_subdiagram_that_is_turned_on_and_off_is_the_dense_one() -> None:
    K = matrix(4, 4, 0.5)
    runs = []
    for k in (K, sp.csr_array(K)):
        inner, d = agents(SwitchedMatrixGain(K=-k, size=1), np.ones(4)), Diagram("outer")
        inner.wire("gain.index", inner.add("one", Sine(amplitude=0.0, bias=1.0)).y)
        for i in range(4):
            inner.output(f"x{i}", f"x{i}.y")
        d.add("inner", subdiagram(inner), enable={"states": "reset", "outputs": "held"})
        d.wire(d.add("is_on", CompareToConstant(constant=0.0)).u, d.add("wave", Sine(omega=5.0)).y)
        d.wire("inner.enable", "is_on.y")
        runs.append(d.run(stop=3, **FIXED))
    assert all(np.array_equal(runs[0][f"inner.x{i}"], runs[1][f"inner.x{i}"]) for i in range(4))
    assert np.ptp(runs[1]["inner.x0"]) > 0.1


def test_a_sparse_gain_is_one_unit_where_blocks_are_coupled_one_by_one() -> None:
    K = 0.5 * matrix(4, 4, 0.5)
    master = {"couple": "each", "step": 0.01}
    runs = [agents(MatrixGain(K=k), np.ones(4)).run(stop=0.5, master=master) for k in (K, sp.csr_array(K))]
    assert all(np.array_equal(runs[0][f"x{k}.y"], runs[1][f"x{k}.y"]) for k in range(4))
    coupling = couple(agents(MatrixGain(K=sp.csr_array(K)), np.ones(4)).flatten(master=master))
    assert isinstance(coupling, Coupling)
    assert [unit.path for unit in coupling.units] == ["mux", "gain", "x0", "x1", "x2", "x3"]


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_exported_coupling_is_that_of_the_diagram(fmi: int) -> None:
    from fmpy import simulate_fmu

    laplacian = graph.laplacian(graph.line(20))
    d = agents(MatrixGain(K=-laplacian), np.linspace(0.0, 1.0, 20))
    for k in range(20):
        d.output(f"a{k}", f"x{k}.y")
    fmu = exported(d, fmi, method="rk4", step=0.01)
    out = simulate_fmu(str(fmu.path), stop_time=1.0, step_size=0.01, output_interval=0.01, fmi_type="CoSimulation")
    results = d.run(stop=1.0, every=0.01, **FIXED)
    exact = np.linspace(0.0, 1.0, 20) @ np.linalg.multi_dot([np.eye(20), _exponential(-laplacian.toarray())])
    for k in range(20):
        assert np.asarray(out[f"a{k}"])[-1] == pytest.approx(results[f"x{k}.y"][-1], abs=1e-14)
        assert results[f"x{k}.y"][-1] == pytest.approx(exact[k], abs=1e-9)


def _exponential(A: Array) -> Array:
    from scipy.linalg import expm

    return np.asarray(expm(A))


@pytest.mark.parametrize("is_begun", [False, True])
def test_a_sparse_matrix_can_be_given_for_a_run_and_does_not_change_in_one(is_begun: bool) -> None:
    laplacian, start = graph.laplacian(graph.ring(4)), np.arange(4.0)
    d = agents(MatrixGain(K=-laplacian), start)
    given = d.run(stop=1, rtol=1e-10, parameters={"gain.K": -2.0 * laplacian})
    assert given["x0.y"][-1] == pytest.approx((_exponential(-2.0 * laplacian.toarray()) @ start)[0], abs=1e-8)
    run = d.start(stop=1, **FIXED)
    if is_begun:
        run.advance(0.5)
    for K in (-2.0 * laplacian, -laplacian.toarray(), sp.eye_array(4)):
        with pytest.raises(UsageError, match=r"E117 gain\.K: cannot change during a run: gain\.K is structural"):
            run.set("gain.K", K)
    assert np.array_equal(run.finish()["x0.y"], d.run(stop=1, **FIXED)["x0.y"])


def test_a_run_goes_on_from_a_file_and_rows_of_a_sweep_run_with_a_sparse_gain(tmp_path: Path) -> None:
    d = agents(MatrixGain(K=-graph.laplacian(graph.grid(3, 3))), np.arange(9.0))
    run = d.start(stop=2, **FIXED)
    run.advance(1.0)
    run.save(tmp_path / "half.json")
    whole = d.run(stop=2, **FIXED)
    assert d.run(stop=2, resume=tmp_path / "half.json", **FIXED)["x3.y"][-1] == whole["x3.y"][-1]
    other = agents(MatrixGain(K=-2.0 * graph.laplacian(graph.grid(3, 3))), np.arange(9.0))
    with pytest.raises(Exception, match="E506"):
        other.run(stop=2, resume=tmp_path / "half.json", **FIXED)
    sweep = d.sweep({"x0.y_start": [0.0, 1.0]}, stop=2, every=1, log=["x3.y"], **FIXED)
    for row, value in enumerate((0.0, 1.0)):
        single = d.run(stop=2, every=1, parameters={"x0.y_start": value}, **FIXED)
        assert np.array_equal(sweep.signals["x3.y"][row], single["x3.y"])
