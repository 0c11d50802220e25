"""Processes for rows that C threads cannot run."""

from blocks import Diagram, FirstOrder, Sine
from blocks.api.batch_processes import Worker, packed


def test_a_worker_that_is_ended_while_it_is_given_a_row_raises_nothing() -> None:
    """Ctrl-C closes its pipes in one thread while another thread writes to them."""
    d = Diagram("lag")
    lag, wave = d.add("lag", FirstOrder()), d.add("wave", Sine())
    d.wire(lag.u, wave.y)
    text, _ = packed(d.batch(["lag.T"], stop=1.0, engine="reference"))
    worker = Worker(text)
    first = worker.run((0, {"lag.T": 0.5}, None), None)
    assert first is not None
    assert first.status == "ok"
    assert worker.process is not None
    worker.process.kill()
    worker.process.stdin.close()  # type: ignore[union-attr]
    ended = worker.run((1, {"lag.T": 0.5}, None), None)
    assert ended is not None
    assert ended.faults[0].code == "E216"
    again = worker.run((2, {"lag.T": 0.5}, None), None)  # by another process
    assert again is not None
    assert again.measures == first.measures
    worker.end()
