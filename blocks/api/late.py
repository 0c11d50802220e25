"""What a Diagram can do by means of rooms above this one: found by name when it is first called.

Sweeps and tunings are made of many runs, and a live server has one, so that their rooms stand on this one; a person
looks for them on the Diagram.
This is the only way up, and `tests/project/test_project.py` holds that nothing else takes it.
"""

from __future__ import annotations

import importlib

_MODULES = {
    "sweep": "studies.sweep_run", "tune": "studies.tuning", "fit": "studies.identification",
    "live": "server.live_server", "edit": "server.live_server",
}  # fmt: skip


def late(name: str, *arguments: object, **named: object) -> object:
    """Call a function of a room above by its name."""
    module = importlib.import_module(f"{__package__.rpartition('.')[0]}.{_MODULES[name]}")
    return getattr(module, name)(*arguments, **named)
