"""`Session`: the policies and scenes behind the page, and the commands of other threads."""

import queue
from collections.abc import Callable, Hashable

import numpy as np

from modpush._types import Angle, Coordinate, Finite, Seed
from modpush._validation import checked_arguments
from modpush.envs.scenes.layouts import TIGHT_SCENES
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.viewer import edits
from modpush.viewer.config import CONTROL_FREQ, PlayConfig
from modpush.viewer.lane import HandPolicy, PolicyLane, Snapshot, make_lane

Command = Callable[[], object]


_PAUSE_AT_END = CONTROL_FREQ  # ticks until the next episode begins by itself


class Session:
    """One or two policies on the same scene, stepped together and changed by commands.

    All methods but `submit` are for the one thread that calls `tick`; other threads hand commands
    over with `submit`. A command that cannot be carried out leaves the scene as it was and says so in
    `message`.

    Args:
        config: Initial settings.

    Raises:
        ValueError: If a policy of the config is not there.
    """

    def __init__(self, config: PlayConfig | None = None) -> None:
        self.config = config or PlayConfig()
        self.scene, self.difficulty = self.config.scene, self.config.difficulty
        self.pushed_object, self.seed = self.config.pushed_object, self.config.seed
        self.paused = self.config.paused
        self.auto_continue = True
        """Begin the next episode by itself after one has ended."""
        self.message = ""
        """Error of the last command; empty if it succeeded."""
        self.policies: tuple[str, ...] = tuple(self.config.policy)
        """The policies as they were given."""
        self.lanes = _make_lanes(self.policies, self.config)
        self.snapshots: list[Snapshot] = []
        """Snapshot of each lane."""
        self._commands: queue.SimpleQueue[tuple[Hashable, Command]] = queue.SimpleQueue()
        self._ticks_since_end = 0
        self.reset()

    @property
    def names(self) -> list[str]:
        """Names of the lanes for the page."""
        return [lane.name for lane in self.lanes]

    @property
    def ended(self) -> bool:
        """True once the episode is over in every lane."""
        return all(shown.ended for shown in self.snapshots)

    def submit(self, command: Command, key: Hashable = None) -> None:
        """Have a command carried out at the next tick; may be called from any thread.

        Args:
            command: One of this session's methods, with its arguments bound.
            key: Of waiting commands with the same key, such as the moves of one drag, only the last
                is carried out.
        """
        self._commands.put((key, command))

    def tick(self) -> None:
        """Carry out the commands that wait, then take a control step unless paused or ended."""
        found: list[tuple[Hashable, Command]] = []
        while not self._commands.empty():
            found.append(self._commands.get())
        last = {key: i for i, (key, _) in enumerate(found)}
        for i, (key, command) in enumerate(found):
            if key is None or last[key] == i:
                self._try(command)
        if self.paused:
            return
        if not self.ended:
            self.step()
        elif self.auto_continue:
            self._ticks_since_end += 1
            if self._ticks_since_end >= _PAUSE_AT_END:
                self._try(self.next_episode)

    def _try(self, command: Command) -> None:
        self.message = ""
        try:
            command()
        except (ValueError, TypeError, ImportError, OSError, RuntimeError) as error:
            self.message = str(error)  # the page and its changes stay

    def step(self) -> None:
        """Take one control step in every lane that still runs."""
        self.snapshots = [
            shown if shown.ended else lane.step()
            for lane, shown in zip(self.lanes, self.snapshots, strict=True)
        ]

    def step_once(self) -> None:
        """Pause, and take one control step."""
        self.paused = True
        if not self.ended:
            self.step()

    @checked_arguments
    def set_paused(self, paused: bool) -> None:
        """Stop the time, or let it run on."""
        self.paused = paused

    @checked_arguments
    def set_auto_continue(self, auto_continue: bool) -> None:
        """Have the next episode begin by itself, or not."""
        self.auto_continue = auto_continue

    @checked_arguments
    def reset(self, seed: Seed | None = None) -> None:
        """Begin the episode of a seed (default: the present one).

        Raises:
            ValueError: If no scene can be drawn with the present settings.
        """
        seed = self.seed if seed is None else seed
        self._start([self._draw(seed)] * len(self.lanes), seed)

    def restart(self) -> None:
        """Restart the present scene, as it was after its last change."""
        self._start([self.snapshots[0].scenario] * len(self.lanes), self.seed)

    def next_episode(self) -> None:
        """Begin the episode of the next seed."""
        self.reset(self.seed + 1)

    def _draw(self, seed: int) -> Scenario:
        lane = self.lanes[0]
        return sample_scenario(
            np.random.default_rng(seed),
            ScenarioConfig(
                scene=self.scene,
                pushed_object=self.pushed_object,
                difficulty=self.difficulty,
                # Through the passages of these families only the inscribed circle fits.
                path_inflation="inscribed" if self.scene in TIGHT_SCENES else None,
            ),
            robot=lane.robot,
            tool=lane.tool,
            goal=self.config.goal,
        )

    def _start(self, scenarios: list[Scenario], seed: int) -> None:
        self.snapshots = [
            lane.start(scenario) for lane, scenario in zip(self.lanes, scenarios, strict=True)
        ]
        self.seed, self._ticks_since_end = seed, 0

    @checked_arguments
    def choose_scene(
        self,
        scene: str | None = None,
        difficulty: float | None = None,
        pushed_object: str | None = None,
    ) -> None:
        """Draw episodes from something else, and begin the one of the present seed.

        Raises:
            ValueError: If there is no such scene or object, or none can be drawn.
        """
        before = self.scene, self.difficulty, self.pushed_object
        self.scene = self.scene if scene is None else scene
        self.difficulty = self.difficulty if difficulty is None else difficulty
        self.pushed_object = self.pushed_object if pushed_object is None else pushed_object
        try:
            self.reset()
        except ValueError:
            self.scene, self.difficulty, self.pushed_object = before
            raise

    @checked_arguments
    def choose_policies(self, *policies: str) -> None:
        """Run other policies, one or two, and begin the present scene again.

        Raises:
            ValueError: If there is no such policy.
        """
        if not 1 <= len(policies) <= 2:
            raise ValueError(f"Session: policies must be one or two, got {len(policies)}.")
        if policies == self.policies:
            return self.restart()
        scenario, before = self.snapshots[0].scenario, (self.lanes, self.policies)
        self.lanes, self.policies = _make_lanes(policies, self.config), policies
        try:
            self._start([scenario] * len(self.lanes), self.seed)
        except BaseException:
            _close(self.lanes)
            self.lanes, self.policies = before
            raise
        _close(before[0])

    @checked_arguments
    def move_goal(self, x: Coordinate, y: Coordinate, yaw: Angle | None = None) -> None:
        """Put the goal elsewhere [m], and turn a goal pose [rad]; object and tool stay where they are."""
        self._change(lambda scenario: edits.move_goal(scenario, x, y, yaw))

    @checked_arguments
    def move_obstacle(
        self, index: int, x: Coordinate, y: Coordinate, yaw: Angle | None = None
    ) -> None:
        """Put an obstacle elsewhere [m, m, rad]."""
        self._change(lambda scenario: edits.move_obstacle(scenario, index, x, y, yaw))

    def _change(self, edit: Callable[[Scenario], Scenario]) -> None:
        """Change the scene of every lane; each continues with its object and its tool where they are."""
        changed = []
        for shown in self.snapshots:
            poses = shown.object_pose, shown.ee_pose
            changed.append(edits.continue_from(edit(shown.present), *poses))
            edits.check_scene(changed[-1], *poses, shown.robot, shown.tool)
        self._start(changed, self.seed)

    @checked_arguments
    def push_by_hand(self, dx: Finite, dy: Finite, dyaw: Finite = 0.0) -> None:
        """Move the tool of the lanes that a person drives, in [-1, 1], base frame."""
        for lane in self.lanes:
            if isinstance(lane.policy, HandPolicy):
                lane.policy.press((dx, dy, dyaw))

    def close(self) -> None:
        """Free the simulators."""
        _close(self.lanes)


def _make_lanes(policies: tuple[str, ...], config: PlayConfig) -> list[PolicyLane]:
    """A lane for each policy, none where one cannot be made."""
    lanes: list[PolicyLane] = []
    try:
        for policy in policies:
            lanes.append(make_lane(policy, config))
    except BaseException:
        _close(lanes)
        raise
    return lanes


def _close(lanes: list[PolicyLane]) -> None:
    for lane in lanes:
        lane.close()
