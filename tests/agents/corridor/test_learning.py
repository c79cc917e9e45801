"""What the corridor controller learns, against numbers worked out by hand and scipy."""

import math

import pytest
import torch
from hypothesis import given, strategies as st
from scipy import stats
from scipy.special import i0

from modpush.agents import CorridorConfig
from modpush.agents.corridor import authors_code
from modpush.agents.corridor.learning import (
    activations,
    bessel_ratio,
    concentration,
    fit_angles,
    preferred_angle,
)

PRIOR = CorridorConfig()


def d(*values):
    return torch.tensor(values, dtype=torch.float64)


def test_the_wrapping_of_the_authors_is_wrong_on_both_sides():
    # 3.5 should become 3.5 - 2 pi = -2.783 and becomes pi - 3.5 = -0.358; -4 is right by luck.
    out = authors_code.wrap_angle(d(1.0, -1.0, 3.5, -4.0, -7.0))
    expected = d(1.0, -1.0, math.pi - 3.5, 2 * math.pi - 4, 7 - 2 * math.pi)
    torch.testing.assert_close(out, expected)


@given(st.floats(0.001, 2000))
def test_concentration_inverts_the_bessel_ratio(kappa):
    assert concentration(bessel_ratio(d(kappa))).item() == pytest.approx(kappa, rel=1e-5)


def test_the_mode_of_the_prior_is_kappa_3_37():
    # I1(k) / I0(k) = 5.84 / 7 = 0.8343 at k = 3.37.
    mu, kappa = fit_angles(torch.zeros(1, 4).double(), torch.zeros(1, 4).bool(), PRIOR)
    assert mu.item() == 0
    assert kappa.item() == pytest.approx(3.37, abs=0.01)


def test_the_posterior_by_hand():
    # Seen 0.2 twice and a third that does not count: R = |5.84 + 2 e^{0.2 i}|, c = 9.
    alphas, valid = d(0.2, 0.2, 1.9)[None], torch.tensor([[True, True, False]])
    mu, kappa = fit_angles(alphas, valid, PRIOR)
    x, y = 5.84 + 2 * math.cos(0.2), 2 * math.sin(0.2)
    assert mu.item() == pytest.approx(math.atan2(y, x))
    assert bessel_ratio(kappa).item() == pytest.approx(math.hypot(x, y) / 9)


def test_the_posterior_is_the_peak_of_prior_times_likelihood():
    alphas = torch.tensor([[0.3, 0.1, -0.2, 0.5]], dtype=torch.float64)
    mu, kappa = fit_angles(alphas, torch.ones(1, 4).bool(), CorridorConfig(prior_direction=0.1))

    def log_density(m, k):
        prior = 5.84 * k * math.cos(0.1 - m) - 7 * math.log(i0(k))
        return prior + stats.vonmises(k, loc=m).logpdf(alphas[0].numpy()).sum()

    best = log_density(mu.item(), kappa.item())
    for dm, dk in ((0.01, 0), (-0.01, 0), (0, 0.05), (0, -0.05)):
        assert log_density(mu.item() + dm, kappa.item() + dk) < best


def test_the_posterior_of_the_authors_keeps_kappa_at_50():
    none = torch.zeros(1, 3).bool()
    mu, kappa = authors_code.fit_angles(torch.zeros(1, 3).double(), none, PRIOR)
    assert (mu.item() % (2 * math.pi), kappa.item()) == (0.0, 50.0)
    alphas = torch.tensor([[0.3, 0.3, 0.3]], dtype=torch.float64)
    mu, kappa = authors_code.fit_angles(alphas, ~none, PRIOR)
    # d/dmu of 50 cos(0.3 - mu) + 292 cos(mu) is 0 at mu = atan2(50 sin 0.3, 292 + 50 cos 0.3)
    # = 0.0435, that is 2.49 degrees; the grid has whole ones.
    assert math.degrees(mu.item()) == pytest.approx(2.0, abs=0.51)
    assert kappa.item() == 50.0


def test_preferred_angles_by_hand():
    alphas, valid = d(0.2, -0.1, 2.0)[None], torch.tensor([[True, True, False]])
    mu, kappa = d(0.0), d(2.0)
    w = [math.exp(2 * (math.cos(a) - 1)) for a in (0.2, -0.1)]
    linear = (w[0] * 0.2 - w[1] * 0.1) / sum(w)
    circular = math.atan2(
        w[0] * math.sin(0.2) - w[1] * math.sin(0.1), w[0] * math.cos(0.2) + w[1] * math.cos(0.1)
    )
    assert authors_code.preferred_angle(alphas, valid, mu, kappa).item() == pytest.approx(linear)
    assert preferred_angle(alphas, valid, mu, kappa).item() == pytest.approx(circular)
    for mean in (preferred_angle, authors_code.preferred_angle):
        assert mean(alphas, ~valid & False, mu, kappa).item() == 0


def test_the_mean_of_angles_across_the_cut_is_on_the_right_side():
    alphas, valid = d(math.pi - 0.1, -math.pi + 0.1)[None], torch.ones(1, 2).bool()
    mu, kappa = d(math.pi), d(3.0)
    assert abs(preferred_angle(alphas, valid, mu, kappa).item()) == pytest.approx(math.pi)
    assert authors_code.preferred_angle(alphas, valid, mu, kappa).item() == pytest.approx(0.0)


def test_activations_by_hand():
    # kappa 3.37, mu 0: at 0.5 rad psi_push = exp(3.37 (cos 0.5 - 1)) = 0.66196.
    push, relocate = activations(d(0.5, 0.0), d(-2.0, 0.0), d(0.0, 0.0), d(3.37, 3.37))
    assert push.tolist() == pytest.approx([0.66196, 1.0], abs=1e-5)
    assert relocate.tolist() == pytest.approx([math.sqrt(1 - 0.66196**2), 0.0], abs=1e-4)


def test_relocation_begins_at_the_published_angles():
    # psi_relocate passes 0.6 at 20.6 degrees for kappa 3.5 and at 5.4 degrees for kappa 50.
    for kappa, degrees in ((3.5, 20.6), (50.0, 5.4)):
        around = d(math.radians(degrees - 0.1), math.radians(degrees + 0.1))
        far = d(3.0, 3.0)  # nothing preferred nearby
        _, relocate = activations(around, far, d(0.0, 0.0), d(kappa, kappa))
        assert relocate[0] < 0.6 < relocate[1]


def test_near_the_preferred_angle_the_deviation_is_measured_from_it():
    # alpha 0.5, alpha_p 0.4: within pi/8, and nearer than straight behind.
    push, _ = activations(d(0.5), d(0.4), d(0.3), d(4.0))
    assert push.item() == pytest.approx(math.exp(4 * (math.cos(0.1) - 1)))
    push, _ = activations(d(0.5), d(0.4), d(0.3), d(4.0), faithful=True)
    assert push.item() == pytest.approx(math.exp(4 * (math.cos(-0.1 - 0.3) - 1)))
    push, _ = activations(d(0.5), d(1.0), d(0.3), d(4.0))  # too far from alpha_p
    assert push.item() == pytest.approx(math.exp(4 * (math.cos(0.5 - 0.3) - 1)))
