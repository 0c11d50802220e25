"""A diagram live in a browser: a server on 127.0.0.1, which owns the document and the run; the page shows both."""
