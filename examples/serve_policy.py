"""Serve a policy to `modpush evaluate` from another process, which needs numpy and safetensors alone.

    python examples/serve_policy.py --port 8770
    modpush evaluate --policy http://127.0.0.1:8770 --set tracks/4 --episodes 8

Replace `act` and `NAME` with a policy of your own. It gets the keys of `PushEnv` as arrays `[B, ...]`,
those of `OccupancyGrid` and `PlannerSubgoals`, and `is_init`; each row is one of the scenes that run side
by side. This one drives behind the object, as seen from the goal, and pushes it straight ahead, whatever
is in the way.
"""

import argparse
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
from safetensors.numpy import load, save

NAME = "straight"
STEP = 0.02  # of the tool, for an action of 1 [m]
BEHIND = 0.02  # of the tool's tip from the object's outline, before it pushes [m]


def act(entries: dict[str, np.ndarray]) -> np.ndarray:
    """Actions `[B, 3]` (dx, dy, dyaw) in [-1, 1], in the robot's base frame.

    Args:
        entries: What the environment emits, by key.
    """
    place, tool = entries["object_pose"][:, :2], entries["ee_pose"][:, :2]
    ahead = entries["goal_position"] - place
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-6)
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    x, y = ((tool - place) * ahead).sum(1), ((tool - place) * aside).sum(1)
    radius = entries["object_radius"][:, 0]
    behind, around = radius + BEHIND, radius + 3 * BEHIND
    side = np.where(y < 0, -1.0, 1.0)
    target_x = np.where(x > -0.5 * behind, -2 * behind, -behind)  # beside it: go back first
    target_y = np.where(x > -0.5 * behind, side * around, 0.0)
    pushing = (x < -0.5 * radius) & (np.abs(y) < 0.01)
    target_x, target_y = np.where(pushing, x + STEP, target_x), np.where(pushing, 0.0, target_y)
    move = (target_x - x)[:, None] * ahead + (target_y - y)[:, None] * aside
    move /= np.maximum(np.abs(move).max(1, keepdims=True), STEP)
    return np.column_stack([move, np.zeros(len(move))]).astype(np.float32)


class Handler(BaseHTTPRequestHandler):
    """Answers `GET /` with the name, and `POST /act` with actions."""

    protocol_version = "HTTP/1.1"  # one connection for all steps

    def do_GET(self) -> None:
        """The policy's name."""
        self._answer(NAME.encode())

    def do_POST(self) -> None:
        """The actions for one control step."""
        entries = load(self.rfile.read(int(self.headers["Content-Length"])))
        self._answer(save({"action": act(entries)}))

    def _answer(self, content: bytes) -> None:
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing for each step."""


def main() -> None:
    """Serve until the process is stopped."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--port", type=int, default=8770)
    server = ThreadingHTTPServer(("127.0.0.1", parser.parse_args().port), Handler)
    print(f"Serving {NAME} at http://127.0.0.1:{server.server_port}", flush=True)
    server.serve_forever()


if __name__ == "__main__":
    main()
