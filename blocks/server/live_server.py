"""A diagram live in a browser, from the first line of its address to its end.

server = LiveServer("loop.json")      # has an address
server.start()                        # reads the diagram, and serves it
server.stop()
"""

from __future__ import annotations

import html
import os
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..model.block_types import Library
from ..text.atomic_write import real
from .transport import Transport, new_token

if TYPE_CHECKING:
    from ..api.diagram import Diagram
    from ..model.trust import Paths
    from .session import Asks, Session

FAR = ("JUPYTERHUB_USER", "COLAB_RELEASE_TAG", "KAGGLE_KERNEL_RUN_TYPE", "BINDER_SERVICE_HOST")
"""Variables of the environment of notebooks whose browser is on another machine."""
_OPENING = threading.Lock()


class LiveServer:
    """A server of one diagram on this machine.

    source: a file or a Diagram. library, variants, values (parameters), inputs, engine, trust: as of `Diagram.run`; a
    page can give none of them that makes code run: library and trust. asks: puts a question to the user at the
    terminal; without it an FMU comes in through the page only into folders of trust. port: 0: a free one. framed: for
    a notebook. edit: pages write the file; where there is none, an empty diagram. url: its address, which holds the
    token that lets a page in.
    """

    def __init__(
        self,
        source: str | Path | Diagram,
        *,
        library: Library = (),
        variants: Mapping[str, str] | None = None,
        values: Mapping[str, object] | None = None,
        inputs: Mapping[str, object] | None = None,
        engine: str | None = None,
        trust: Paths = (),
        asks: Asks | None = None,
        port: int = 0,
        framed: bool = False,
        edit: bool = False,
    ) -> None:
        """Raises UsageError (E501) where the port cannot be opened."""
        self._edits, self._tabs = edit, dict[Path, LiveServer]()  # of all diagrams that are edited beside each other
        self._source, self._library, self._variants = source, library, variants
        self._given: dict[str, Any] = {"values": values, "inputs": inputs, "engine": engine}
        self._given |= {"trust": trust, "asks": asks}
        self._session: Session | None = None
        self._transport = Transport(
            new_token(),
            lambda client, message: self._open.received(client, message),
            lambda client: self._open.connected(client),
            lambda client: self._open.disconnected(client),
            port=port,
            framed=framed,
        )
        self.url, self.port = self._transport.url, self._transport.port

    @property
    def _open(self) -> Session:
        assert self._session is not None  # nobody is admitted before
        return self._session

    @property
    def ticket(self) -> str:
        """An address that lets one page in, once: other users may see it in the list of processes."""
        return self._transport.ticket()

    def start(self) -> LiveServer:
        """Read the diagram, and let pages in; those that came too early waited. Raises UsageError: there is no file."""
        # The modules of the messages that pages may send are here for what they declare.
        from . import analysis_messages, gestures, knobs, panel, scope_messages  # noqa: F401
        from .editor import Editor
        from .open_document import Document
        from .session import Session

        try:
            given: dict[str, Any] = {"library": self._library, "variants": self._variants}
            if self._edits and isinstance(self._source, (str, Path)):
                document: Document = Editor(self._source, self._open_tab, **given)
            else:
                document = Document(self._source, **given)
            self._session = Session(document, **self._given)
            if isinstance(document, Editor):
                self._tabs[real(document.file)] = self
        except BaseException:
            self._transport.stop()
            raise
        self._transport.start()
        return self

    def _open_tab(self, path: Path) -> str:
        """The address of another diagram, edited by a server beside this one: by one for all tabs of it."""
        with _OPENING:
            if path not in self._tabs:
                given = {**self._given, "values": None, "inputs": None}
                other = LiveServer(path, library=self._library, edit=True, **given)
                other._tabs = self._tabs
                other.start()
            return self._tabs[path].ticket

    def stop(self) -> None:
        """End the run, close the pages and the port, and all tabs beside it. Once more does nothing."""
        self._transport.stop()
        if self._session is not None:
            self._session.close()  # which may be opening a tab
        while self._tabs:
            self._tabs.popitem()[1].stop()

    def __repr__(self) -> str:
        return f"<live: {self.url}>"

    def _repr_html_(self) -> str:
        """The page in a frame; where the notebook's browser is known to be on another machine, what to do there."""
        url = html.escape(self.url)
        if any(name in os.environ for name in FAR):
            return (
                "<p>This notebook runs on another machine, whose 127.0.0.1 your browser cannot reach: "
                "run <code>blocks live</code> on your own machine, or forward the port by "
                f"<code>ssh -L {self.port}:127.0.0.1:{self.port} HOST</code> and open <code>{url}</code>.</p>"
            )
        frame = f'<iframe src="{url}" title="{url}" style="width:100%;height:46em;border:0"></iframe>'
        return f'{frame}<p>Nothing to see? <a href="{url}" target="_blank" rel="noopener">Open it in a tab.</a></p>'


def live(diagram: Diagram, **given: Any) -> LiveServer:
    """Serve a diagram to a notebook. given: as of LiveServer."""
    return LiveServer(diagram, framed=True, **given).start()


def edit(file: str | Path, **given: Any) -> LiveServer:
    """Let a notebook edit a diagram file. given: as of LiveServer."""
    return LiveServer(file, framed=True, edit=True, **given).start()
