"""`play`: opens the page."""

import contextlib
import errno
import io
import os
import socket
import threading
import time
import warnings
from collections.abc import Iterator
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import torch

from modpush._extras import require_extra
from modpush.viewer.config import CONTROL_FREQ, PlayConfig
from modpush.viewer.controls import Controls
from modpush.viewer.lane_view import LaneView
from modpush.viewer.session import Session

if TYPE_CHECKING:
    from viser import ViserServer

_BESIDE = 1.35  # distance of two lanes' robots [m]
_CAMERA_OF_ONE = (1.08, -0.45, 0.72), (0.40, 0.0, 0.05)
_CAMERA_OF_TWO = (1.75, 0.0, 1.0), (0.40, 0.0, 0.05)
"""First position of the camera, and the point that it looks at [m]."""
_DRAW_PERIOD = 1 / 30  # at high speeds not every step is drawn [s]
_PORTS = 100  # that are tried, from the one asked for on
_WAIT_FOR_TAB = 0.1  # [s]
_LOCAL = ("127.0.0.1", "localhost", "::1")


class Page:
    """A session and the page that shows it, to all tabs that look at it.

    Time stands still while no tab is open. All tabs show the same session,
    and each can change it.

    Args:
        config: Settings of the page.

    Raises:
        MissingExtraError: If viser is not installed; the message says how to install it.
        ValueError: If a policy of the config is not there.
    """

    def __init__(self, config: PlayConfig) -> None:
        self.config = config
        self.server = _make_server(config)
        try:
            self.session = Session(config)
        except BaseException:
            self.server.stop()
            raise
        self.controls = Controls(self.server, self.session)
        self._views: list[LaneView] = []
        self._stopped = threading.Event()
        self._last_drawn = 0.0
        self.draw()

    @property
    def address(self) -> str:
        """Address of the page on this machine."""
        # Every address of this machine is listened on by these, and none is called so.
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.config.host, self.config.host)
        return f"http://{f'[{host}]' if ':' in host else host}:{self.server.get_port()}"

    def run(self) -> None:
        """Run until `stop` is called or the program is interrupted."""
        due = time.monotonic()
        while not self._stopped.is_set():
            if not self.server.get_clients():
                self._stopped.wait(_WAIT_FOR_TAB)
                due = time.monotonic()
                continue
            self.session.tick()
            self.draw()
            due += 1 / (CONTROL_FREQ * self.controls.time.speed)
            left = due - time.monotonic()
            if left > 0:
                self._stopped.wait(left)
            else:
                due = time.monotonic()  # too slow: what is missed is not made up for

    def draw(self) -> None:
        """Bring all tabs up to the session's state, 30 times a second at most."""
        now = time.monotonic()
        if now - self._last_drawn < _DRAW_PERIOD:
            return
        self._last_drawn = now
        session = self.session
        with self.server.atomic():
            if len(self._views) != len(session.lanes):
                self._make_views()
            for view, lane, shown in zip(
                self._views, session.lanes, session.snapshots, strict=True
            ):
                view.update(shown, self.controls.overlays, lane.name)
            self.controls.update()

    def _make_views(self) -> None:
        for view in self._views:
            view.remove()
        count = len(self.session.lanes)
        offsets = [0.0] if count == 1 else [-_BESIDE / 2, _BESIDE / 2]  # left and right
        self._views = [
            LaneView(self.server, self.session, f"/lane{i}", offset)
            for i, offset in enumerate(offsets)
        ]
        camera = self.server.initial_camera
        camera.position, camera.look_at = _CAMERA_OF_ONE if count == 1 else _CAMERA_OF_TWO
        for client in self.server.get_clients().values():
            client.camera.position, client.camera.look_at = camera.position, camera.look_at

    def stop(self) -> None:
        """End `run`; may be called from any thread."""
        self._stopped.set()

    def close(self) -> None:
        """Close the page, and free the simulators."""
        self.stop()
        self.session.close()
        self.server.stop()


def _make_server(config: PlayConfig) -> "ViserServer":
    require_extra("modpush.viewer.play", "viser")
    import viser

    port = _free_port(config.host, config.port)
    # `play` prints the address.
    with contextlib.redirect_stdout(io.StringIO()), _refusing_other_origins(config.host):
        server = viser.ViserServer(host=config.host, port=port, label="modpush")
    server.scene.set_up_direction("+z")
    # Shadows and reflections are slow where WebGL runs in software: without the latter three times as
    # many pictures are drawn. An even light stands in for them.
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.configure_environment_map(hdri=None)
    server.scene.add_light_ambient("/ambient_light", intensity=1.0)
    return server


def _free_port(host: str, port: int) -> int:
    """The first port that can be listened on; viser would wait for ever where there is none."""
    for candidate in range(port, min(port + _PORTS, 65536)):
        try:
            family, kind, _, _, address = socket.getaddrinfo(
                host, candidate, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            with socket.socket(family, kind) as tried:
                if os.name == "posix":
                    tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                tried.bind(address)
                return candidate
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise ValueError(
                    f"PlayConfig: host must be an address of this machine, got {host!r} ({error})."
                ) from None
            reason = error
    raise ValueError(
        f"PlayConfig: port must be free, as must one of the {_PORTS} after it, got {port} ({reason})."
    )


@contextlib.contextmanager
def _refusing_other_origins(host: str) -> Iterator[None]:
    """Have the server that viser starts here answer only its own page, of the pages in a browser.

    A browser lets every page that is open in it connect to any address, and says in `Origin` which page
    it is. viser does not look at it, and has no option for it.
    """
    from websockets.asyncio import server

    serve = server.serve

    def serve_own_page(*args: Any, process_request: Any, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            if _is_of_page(host, request.headers.get("Origin"), request.headers.get("Host")):
                return process_request(connection, request)
            return connection.respond(HTTPStatus.FORBIDDEN, "This is not the page's own origin.\n")

        return serve(*args, process_request=process, **options)

    server.serve = serve_own_page  # type: ignore[assignment, misc]  # it is a class
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]


def _is_of_page(host: str, origin: str | None, asked: str | None) -> bool:
    """True for requests of this page, and for those that no page in a browser makes (origin None).

    `asked` is the request's `Host`. A page elsewhere can have its own name stand for this machine, so
    that `Origin` agrees with it: where only this machine is listened to, it must be local.
    """
    if origin is None:
        return True
    if urlsplit(origin).netloc != asked:
        return False
    return host not in _LOCAL or urlsplit(origin).hostname in _LOCAL


def play(config: PlayConfig | None = None) -> None:
    """Open the page, print its address, and run until interrupted (Ctrl-C).

    Args:
        config: Settings of the page.

    Raises:
        MissingExtraError: If viser is not installed; the message says how to install it.
        ValueError: If a policy of the config is not there.
    """
    config = config or PlayConfig()
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    torch.set_num_threads(1)  # the networks are small: threads would only wait for each other
    page = Page(config)
    if config.port and page.server.get_port() != config.port:
        print(f"Port {config.port} is taken.")
    elsewhere = "" if config.host in page.address else ", elsewhere at this machine's own address"
    print(f"The page is at {page.address}{elsewhere} (Ctrl-C ends it).", flush=True)
    try:
        page.run()
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
