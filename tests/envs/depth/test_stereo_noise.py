"""The noise of a stereo camera, on a step from a near surface to a far one."""

import numpy as np
import pytest

from modpush.envs.depth.stereo_noise import stereo_noise

NEAR, FAR = 0.8, 1.0


def step_image() -> np.ndarray:
    image = np.full((200, 200), FAR, dtype=np.float32)
    image[60:140, 60:140] = NEAR
    return image


def test_noise_grows_with_the_square_of_depth() -> None:
    spread = []
    for depth in (0.5, 1.0):
        image = np.full((200, 200), depth, dtype=np.float32)
        noisy = stereo_noise(image, np.random.default_rng(0), axial=0.002)
        spread.append((noisy[noisy > 0] - depth).std())
    assert spread == pytest.approx([0.0005, 0.002], rel=0.05)


def test_without_parameters_nothing_changes() -> None:
    clean = stereo_noise(
        step_image(),
        np.random.default_rng(0),
        axial=0.0,
        jitter=0.0,
        baseline=0.0,
        edge_holes=0.0,
        flying=0.0,
        grazing_holes=0.0,
        speckle=0.0,
    )
    assert (clean == step_image()).all()


def test_edges_have_holes_and_pixels_between_the_surfaces() -> None:
    noisy = stereo_noise(step_image(), np.random.default_rng(0), axial=0.0, speckle=0.0, baseline=0)
    edge = np.zeros((200, 200), dtype=bool)
    edge[59:141, 59:141] = True
    edge[61:139, 61:139] = False
    assert 0.2 < (noisy[edge] == 0).mean() < 0.4
    between = (noisy > NEAR + 0.01) & (noisy < FAR - 0.01)
    assert 0.1 < between[edge].mean() < 0.2
    away = np.ones((200, 200), dtype=bool)
    away[54:146, 54:146] = False
    assert (noisy[away] == np.float32(FAR)).all()


def test_the_second_imager_s_shadow_lies_left_of_the_foreground() -> None:
    options = {
        "jitter": 0.0,
        "edge_holes": 0.0,
        "flying": 0.0,
        "grazing_holes": 0.0,
        "speckle": 0.0,
    }
    noisy = stereo_noise(
        step_image(), np.random.default_rng(0), 520.0, axial=0.0, baseline=0.05, **options
    )
    # Disparities are 520 * 0.05 / 0.8 = 32.5 and 26 px: 6.5 px of the background are hidden.
    assert (noisy[100, 54:60] == 0).all()
    assert (noisy[100, :53] > 0).all()
    assert (noisy[100, 60:] > 0).all()


def test_no_reading_stays_none_and_a_seed_repeats_the_noise() -> None:
    image = step_image()
    image[:20] = 0.0
    first, second = (stereo_noise(image, np.random.default_rng(3)) for _ in range(2))
    assert (first[:17] == 0).all()
    assert (first == second).all()


def test_a_surface_at_a_grazing_angle_has_holes() -> None:
    # 5 mm of depth per pixel of 520 px at 0.5 m: tan = 5.2, an angle of 79 degrees; 8 mm: 83 degrees.
    for step, share in ((0.005, 0.0), (0.008, 0.8)):
        image = np.tile(np.float32(0.45 + step * np.arange(20)), (200, 1))
        noisy = stereo_noise(
            image,
            np.random.default_rng(0),
            axial=0.0,
            jitter=0.0,
            baseline=0.0,
            flying=0.0,
            edge_holes=0.0,
            speckle=0.0,
        )
        assert (noisy[:, 3:8] == 0).mean() == pytest.approx(share, abs=0.05)
