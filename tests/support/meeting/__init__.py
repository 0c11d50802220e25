"""Diagrams in which capabilities meet, run in several ways whose results must agree.

    python -m tests.support.meeting --seed 3 --minutes 10

Each feature of a diagram (copies, a part that is switched, an FMU, ...) and each way to run it is a factor with levels
(`features.FACTORS`). A covering array (`covering`) has each pair of levels at least once; `features.case` makes a
diagram of one of its rows, `ways` runs it and compares, and `shrinking` leaves out blocks while the run still fails.

A case is a plain dict, which is written as JSON and reads back:

    diagram   the document of the diagram, with the settings of its run
    fmus      by file name the diagram that is exported: {"fmi": 3, "diagram": {...}}
    same      pairs of signals of the diagram that must be equal: [a, b, "exact" or "near"]
    values    other values for parameters
    ways      names of `ways.WAYS`
"""
