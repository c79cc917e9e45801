"""What is drawn is what physics uses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from modpush.envs import OBJECTS, Obstacle
from modpush.envs.engines.sapien.obstacle_bodies import obstacle_part
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.geometry import box, capsule, cylinder, prism
from modpush.viewer.overlays import primitive_mesh

TRIANGLE = ((0.0, 0.0), (0.3, 0.0), (0.0, 0.2))


@pytest.mark.parametrize(
    ("part", "volume"),
    [
        (box(0.2, 0.3, 0.4), 0.024),
        (cylinder(0.1, 0.5), np.pi * 0.01 * 0.5),
        (capsule(0.1, 0.5), np.pi * 0.01 * 0.5 + 4 / 3 * np.pi * 0.001),
        (prism(TRIANGLE, 0.5), 0.5 * 0.03),
    ],
    ids=["box", "cylinder", "capsule", "prism"],
)
def test_a_mesh_is_closed_and_encloses_the_solid_s_volume(part, volume) -> None:
    mesh = primitive_mesh(part)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume, rel=0.02)  # positive: the faces look outwards


def test_a_mesh_is_turned_and_placed_as_its_primitive() -> None:
    part = cylinder(0.1, 0.6, (1.0, 2.0, 3.0), rpy=(0.0, np.pi / 2, 0.0))  # along x
    vertices = primitive_mesh(part).vertices
    assert vertices.min(0) == pytest.approx([0.7, 1.9, 2.9])
    assert vertices.max(0) == pytest.approx([1.3, 2.1, 3.1])


@pytest.mark.parametrize(("robot", "seed"), [("ur5", 0), ("ur5", 1), ("ur10", 2)])
def test_the_links_are_where_physics_has_them(robot, seed) -> None:
    from modpush.envs import PushEnv

    env = PushEnv(1, depth=None, seed=seed, robot=robot)
    td = env.reset()
    names = [*(link.name for link in ROBOTS[robot].links), "tool"]
    physics = env._batch.link_transforms_of(0, names)
    found = ROBOTS[robot].link_transforms(td["joint_position"][0].numpy())
    for transform, row in zip(found, physics, strict=True):
        assert transform[:3, 3] == pytest.approx(row[:3], abs=2e-6)
        rotation = Rotation.from_quat(row[3:], scalar_first=True).as_matrix()
        assert transform[:3, :3] == pytest.approx(rotation, abs=2e-6)
    tip = found[-1] @ [0.0, 0.0, TOOLS["2f85"].length, 1.0]
    assert tip[:2] == pytest.approx(td["ee_pose"][0, :2].numpy(), abs=2e-6)
    assert tip[2] == pytest.approx(OBJECTS["small_cube"].tool_height, abs=2e-4)
    env.close()


def test_an_obstacle_is_drawn_with_the_size_that_physics_gives_it() -> None:
    obstacle = Obstacle((0.4, 0.06, 0.06), (0.5, 0.1, 0.3))
    extent = np.ptp(primitive_mesh(obstacle_part(obstacle)).vertices, axis=0)
    assert extent == pytest.approx(obstacle.size)
