"""The browser: a diagram drawn, run and turned in a page, which a server on this machine gives.

    document (the file)  --+
    live_run (the run)   --+--> session --messages--> transport --> page/

The server owns the document and the run; the page shows them and asks. `guard` stands before everything.
"""
