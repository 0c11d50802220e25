"""A diagram live in a browser, from the first line of its address to its end.

server = LiveServer("loop.json")      # has an address
server.start()                        # reads the diagram, and serves it
server.stop()
"""

from __future__ import annotations

import html
import os
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..model.block_types import Library
from ..text.atomic_write import real
from .transport import Transport, new_token

if TYPE_CHECKING:
    from ..api.case import Case
    from ..api.diagram import Diagram
    from ..model.trust import Paths
    from .session import Asks, Session

FAR = ("JUPYTERHUB_USER", "COLAB_RELEASE_TAG", "KAGGLE_KERNEL_RUN_TYPE", "BINDER_SERVICE_HOST")
"""Variables of the environment of notebooks whose browser is on another machine."""
_OPENING = threading.Lock()


class LiveServer:
    """A server of one diagram on this machine.

    source: a file or a Diagram. case: parameters, inputs, variants, engine and trust. A page cannot give what makes
    code run: library and trust. asks: puts a question to the user at the terminal; without it an FMU comes in through
    the page only into folders of trust. port: 0: a free one. framed: for a notebook. edit: pages write the file; where
    there is none, an empty diagram. url: its address, which holds the token that lets a page
    in.
    """

    def __init__(
        self,
        source: str | Path | Diagram,
        case: Case | None = None,
        *,
        library: Library = (),
        asks: Asks | None = None,
        port: int = 0,
        framed: bool = False,
        edit: bool = False,
    ) -> None:
        """Raises UsageError (E501) where the port cannot be opened."""
        self._edits, self._tabs = edit, dict[Path, LiveServer]()  # of all diagrams that are edited beside each other
        self._source, self._library, self._case, self._asks = source, library, case, asks
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
        from ..api.case import Case

        # The modules of the messages that pages may send are here for what they declare.
        from . import analysis_messages, gestures, knobs, map_messages, panel, scope_messages  # noqa: F401
        from .editor import Editor
        from .open_document import Document
        from .session import Session

        case = self._case = self._case or Case()
        try:
            given: dict[str, Any] = {"library": self._library, "variants": case.variants}
            if self._edits and isinstance(self._source, (str, Path)):
                document: Document = Editor(self._source, self._open_tab, **given)
            else:
                document = Document(self._source, **given)
            self._session = Session(document, case, self._asks)
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
                case = None if self._case is None else self._case.only("engine", "trust")
                other = LiveServer(path, case, library=self._library, asks=self._asks, edit=True)
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


def live(diagram: Diagram, case: Case, *, port: int) -> LiveServer:
    """Serve a diagram to a notebook."""
    return LiveServer(diagram, case, port=port, framed=True).start()


def edit(file: str | Path, *, library: Library, trust: Paths, port: int) -> LiveServer:
    """Let a notebook edit a diagram file."""
    from ..api.case import Case

    return LiveServer(file, Case(trust=trust), library=library, port=port, framed=True, edit=True).start()
