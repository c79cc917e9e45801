"""The page in a real browser, headless, with WebGL in software."""

import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modpush.envs import Scenario
from modpush.viewer import Page, PlayConfig
from modpush.viewer.lane_view import ray_on_plane
from modpush.viewer.page import _make_server

in_a_browser = pytest.mark.slow  # WebGL in software, which a busy machine may kill
NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
SCREENSHOTS = Path(__file__).parents[2] / "build" / "play"
_NOT_OURS = "Unable to preventDefault inside passive event listener"  # viser's, at a drag
_PATIENCE = 90_000  # a page that is drawn in software on a busy machine is slow [ms]
ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


def wait_for(condition: Callable[[], bool], seconds: float = 90.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.05)


@pytest.fixture
def page() -> Iterator[Page]:
    page = Page(PlayConfig(port=0, paused=True))
    running = threading.Thread(target=page.run)
    running.start()
    yield page
    page.stop()
    running.join(30)
    assert not running.is_alive()
    page.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    if CHROMIUM is None:
        pytest.skip(f"needs one of {', '.join(NAMES)}: apt-get install chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


def open_tab(browser: Any, page: Page, errors: list[str]) -> Any:
    tab = browser.new_page(viewport={"width": 1000, "height": 620})
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.on(
        "console",
        lambda line: (
            errors.append(line.text)
            if line.type == "error" and _NOT_OURS not in line.text
            else None
        ),
    )
    count = len(page.server.get_clients())
    tab.goto(page.address)
    tab.set_default_timeout(_PATIENCE)
    tab.get_by_text("Single step").wait_for()
    wait_for(lambda: len(page.server.get_clients()) > count)
    return tab


def on_screen(page: Page, tab: Any, point: tuple[float, float, float]) -> tuple[float, float]:
    """Where the page's camera shows a point of the world, in pixels of the tab."""
    (client,) = page.server.get_clients().values()
    camera = client.camera
    w, x, y, z = camera.wxyz
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    right, down, ahead = rotation.T @ (np.array(point) - camera.position)
    box = tab.locator("canvas").first.bounding_box()
    focal = box["height"] / 2 / np.tan(camera.fov / 2)
    u = box["x"] + box["width"] / 2 + focal * right / ahead
    v = box["y"] + box["height"] / 2 + focal * down / ahead
    return float(u), float(v)


def drag(page: Page, tab: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    tab.mouse.move(*on_screen(page, tab, (*start, 0.0)))
    tab.mouse.down()
    for share in np.linspace(0.0, 1.0, 6)[1:]:
        x, y = np.array(start) + share * np.subtract(end, start)
        tab.mouse.move(*on_screen(page, tab, (x, y, 0.0)))
        time.sleep(0.1)
    tab.mouse.up()


@in_a_browser
def test_a_person_drags_the_goal_adds_an_obstacle_and_sees_success(page, browser) -> None:
    errors: list[str] = []
    tab = open_tab(browser, page, errors)
    session = page.session
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)

    tab.get_by_role("tab", name="Scene").click()
    tab.get_by_role("button", name="Add a cube").click()
    wait_for(lambda: len(session.snapshots[0].scenario.obstacles) == 3)

    time.sleep(1.0)  # the meshes are drawn
    goal = session.snapshots[0].scenario.goal_position
    drag(page, tab, goal, (0.62, -0.25))
    wait_for(lambda: session.snapshots[0].scenario.goal_position != goal)
    wait_for(
        lambda: (
            np.hypot(*np.subtract(session.snapshots[0].scenario.goal_position, (0.62, -0.25)))
            < 0.03
        )
    )
    tab.get_by_role("tab", name="Overlays").click()
    tab.get_by_label("Inflated map").check()
    tab.get_by_role("tab", name="Run").click()
    tab.get_by_label("Pause").uncheck()
    wait_for(lambda: session.snapshots[0].step > 12)
    tab.get_by_role("tab", name="Overlays").click()
    tab.screenshot(path=SCREENSHOTS / "running.png")
    wait_for(lambda: session.ended)
    assert session.snapshots[0].flags["success"]
    assert session.message == ""
    tab.get_by_text("success").first.wait_for()
    tab.screenshot(path=SCREENSHOTS / "success.png")
    tab.close()
    assert not errors


@in_a_browser
def test_goal_and_obstacles_are_changed_while_it_runs(page, browser) -> None:
    errors: list[str] = []
    tab = open_tab(browser, page, errors)
    session = page.session

    def scenario() -> Scenario:
        return session.snapshots[0].scenario

    # Nobody presses a key, so that the object does not come to the goal in the meantime.
    session.submit(lambda: session.choose_policies("hand"))
    wait_for(lambda: session.policies == ("hand",))
    tab.get_by_label("Pause").uncheck()
    wait_for(lambda: session.snapshots[0].step > 0)
    time.sleep(1.0)  # the meshes are drawn
    goal, bar = scenario().goal_position, scenario().obstacles[0].pose
    drag(page, tab, goal, (goal[0], goal[1] - 0.15))
    wait_for(lambda: scenario().goal_position[1] < goal[1] - 0.1)
    assert not session.paused
    drag(page, tab, bar[:2], (bar[0] - 0.06, bar[1]))
    wait_for(lambda: np.hypot(*np.subtract(scenario().obstacles[0].pose[:2], bar[:2])) > 0.03)
    assert not session.paused
    tab.screenshot(path=SCREENSHOTS / "changed.png")
    tab.close()
    assert not errors


@in_a_browser
def test_two_tabs_show_one_session_and_time_stands_still_without_a_tab(page, browser) -> None:
    errors: list[str] = []
    tabs = [open_tab(browser, page, errors) for _ in range(2)]
    tabs[0].get_by_label("Pause").uncheck()
    wait_for(lambda: page.session.snapshots[0].step > 0)
    wait_for(lambda: not tabs[1].get_by_label("Pause").is_checked())
    tabs[1].keyboard.press("n")  # a single step pauses, for both
    wait_for(lambda: page.session.paused and tabs[0].get_by_label("Pause").is_checked())
    tabs[0].get_by_label("Pause").uncheck()
    wait_for(lambda: not page.session.paused)
    page.session.submit(lambda: page.session.reset(0))
    for tab in tabs:
        tab.close()
    wait_for(lambda: not page.server.get_clients())
    time.sleep(0.3)
    step = page.session.snapshots[0].step
    time.sleep(0.5)
    assert page.session.snapshots[0].step == step
    tab = open_tab(browser, page, errors)
    wait_for(lambda: page.session.snapshots[0].step > step)
    tab.close()
    assert not errors


def test_a_busy_port_gives_way_to_the_next_free_one() -> None:
    with socket.socket() as busy:
        busy.bind(("127.0.0.1", 0))
        busy.listen()
        port = busy.getsockname()[1]
        page = Page(PlayConfig(port=port, policy=("hand",)))
        assert page.server.get_port() > port
        assert page.address == f"http://127.0.0.1:{page.server.get_port()}"
        page.close()


@pytest.mark.parametrize("host", ["10.255.255.1", "no-such-host.invalid"])
def test_a_host_that_is_not_this_machine_is_refused_at_once(host) -> None:
    with pytest.raises(ValueError, match=f"host must be an address of this machine, got '{host}'"):
        Page(PlayConfig(host=host, policy=("hand",)))


def test_a_dragged_point_is_where_the_ray_meets_the_table() -> None:
    eye, through = np.array([0.0, 0.0, 1.0]), np.array([0.1, 0.2, 0.5])
    assert ray_on_plane(eye, through, 0.0) == pytest.approx([0.2, 0.4])
    assert ray_on_plane(eye, np.array([0.1, 0.0, 1.5]), 0.0) is None
    assert ray_on_plane(eye, np.array([0.1, 0.0, 1.0]), 0.0) is None


@pytest.mark.parametrize(
    ("origin", "host", "answered"),
    [
        (None, None, True),  # not a page in a browser
        ("http://127.0.0.1:{port}", None, True),
        ("http://localhost:{port}", "localhost:{port}", True),
        ("http://localhost:9000", "localhost:9000", True),  # through a tunnel
        ("http://evil.example", None, False),
        ("http://127.0.0.1:1", None, False),
        ("null", None, False),
        (
            "http://evil.example:{port}",
            "evil.example:{port}",
            False,
        ),  # its name stands for this machine
    ],
)
def test_the_server_answers_no_page_but_its_own(
    origin: str | None, host: str | None, answered: bool
) -> None:
    server = _make_server(PlayConfig(port=0))
    port = server.get_port()
    key = "dGhlIHNhbXBsZSBub25jZQ=="
    lines = [
        "GET / HTTP/1.1",
        f"Host: {(host or '127.0.0.1:{port}').format(port=port)}",
        f"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {key}",
        "Sec-WebSocket-Version: 13",
        *([] if origin is None else [f"Origin: {origin.format(port=port)}"]),
    ]
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=30) as client:
            client.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
            status = client.recv(64).split()[1]
    finally:
        server.stop()
    assert status == (b"101" if answered else b"403")
