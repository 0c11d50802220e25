"""`blocks doctor`."""

from __future__ import annotations

import argparse

from .options import Verbs, takes_json
from .output import emit, printable, say, tell_faults


def add(verbs: Verbs) -> None:
    doctor = verbs.add_parser(
        "doctor",
        help="show versions, the compiler and the cache, and test them",
        description="Show the versions, the C compiler and whether it works, the engine that runs use, and the "
        "cache of compiled code. Exit code 2 if a compiler is found, or CC is set, and it does not work.",
    )
    doctor.add_argument("--clear-cache", action="store_true", help="empty the cache of compiled code, and nothing else")
    takes_json(doctor)
    doctor.set_defaults(verb=_doctor)


def _doctor(options: argparse.Namespace) -> int:
    from ..api.installation import clear_cache, examine

    if options.clear_cache:
        place, gone = clear_cache()
        if options.json:
            emit({"event": "done", "removed": gone.entries, "bytes": gone.bytes, "folder": str(place.folder)})
        else:
            entries = f"{gone.entries} {'entry' if gone.entries == 1 else 'entries'}"
            print(printable(f"{place.folder}: {entries} removed, {gone.bytes / 2**20:.1f} MiB"))
        if place.is_temporary:
            say(f"the cache of other runs was left alone: {place.reason}")
        return 0
    health = examine()
    if not options.json:
        print(printable("\n".join(health.lines())))
    tell_faults(health.faults, options.json)
    if options.json:
        emit({"event": "done", **health.entry()})
    return 2 if health.faults else 0
