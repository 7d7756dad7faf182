"""Learning minimises P2's convex loss, whatever it starts from, and finds again what a made-up person minimises."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reaching_people import MODEL, recording
from scipy.optimize import minimize

from humanpred_ros.errors import MotionError, SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.reaching.demonstrations import Demonstration, SamplingSettings, demonstration
from humanpred_ros.reaching.features import (
    DISTANCE_NAMES,
    FEATURE_NAMES,
    N_FEATURES,
    RULES,
    SCALES,
    ReachFeatures,
)
from humanpred_ros.reaching.piirl import (
    Contrast,
    PiirlLoss,
    PiirlSettings,
    PiirlSolution,
    contrasts,
    learn_weights,
)

#: With and without the demonstration and the penalty.
CONFIGS = tuple(PiirlSettings(with_demonstration=own, l2=l2) for own in (False, True) for l2 in (0.0, 0.02))
#: Of those, some that the solver is tried on.
SOLVED = (CONFIGS[0], CONFIGS[-1])


def made_up(seed: int = 0, n_demos: int = 3, shift: float = 0.5) -> list[Contrast]:
    """Contrasts of features of very different size, not separable: some samples are better than their demonstration."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-3.0, 0.0, N_FEATURES)
    return [
        Contrast(f"d{k}", f"r{k}", size * (shift + rng.normal(size=(200, N_FEATURES)))) for k in range(n_demos)
    ]  # fmt: skip


@pytest.mark.parametrize("config", CONFIGS)
def test_gradients_are_those_of_finite_differences(config: PiirlSettings) -> None:
    blocks = [contrast.differences for contrast in made_up()]
    w = np.random.default_rng(1).uniform(0.0, 3.0, N_FEATURES)
    _, gradient = PiirlLoss(blocks, config).at(w)
    h = 1e-5
    numeric = [
        (PiirlLoss(blocks, config).at(w + h * e)[0] - PiirlLoss(blocks, config).at(w - h * e)[0]) / (2.0 * h)
        for e in np.eye(N_FEATURES)
    ]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-6 * np.abs(gradient).max())


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from(CONFIGS))
def test_gradients_hold_for_any_blocks_and_weights(seed: int, config: PiirlSettings) -> None:
    """Blocks of any lengths, differences of any size and sign, weights at their lower bound and far up."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-6.0, 2.0, N_FEATURES)
    blocks = [size * (rng.normal() + rng.normal(size=(n, N_FEATURES))) for n in rng.integers(1, 30, rng.integers(1, 5))]
    w = np.where(rng.random(N_FEATURES) < 0.3, 0.0, 10.0 ** rng.uniform(-2.0, 1.0, N_FEATURES) / size)
    direction = rng.normal(size=N_FEATURES) / size
    loss, gradient = PiirlLoss(blocks, config).at(w)
    h = 1e-5
    ahead, behind = (PiirlLoss(blocks, config).at(w + s * h * direction)[0] for s in (1, -1))
    assert np.isfinite(loss)
    assert gradient @ direction == pytest.approx(
        (ahead - behind) / (2.0 * h), rel=1e-4, abs=1e-6 * (1.0 + abs(loss) + np.abs(gradient * direction).max())
    )


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from(CONFIGS), st.floats(0.0, 1.0))
def test_losses_lie_below_their_chords_and_above_their_tangents(seed: int, config: PiirlSettings, share: float) -> None:
    rng = np.random.default_rng(seed)
    blocks = [rng.normal(size=(20, N_FEATURES)) for _ in range(3)]
    a, b = 10.0 ** rng.uniform(-2.0, 2.0) * rng.random((2, N_FEATURES))
    (at_a, slope), (at_b, _) = (PiirlLoss(blocks, config).at(w) for w in (a, b))
    between = PiirlLoss(blocks, config).at((1.0 - share) * a + share * b)[0]
    slack = 1e-9 * (1.0 + abs(at_a) + abs(at_b))
    assert between <= (1.0 - share) * at_a + share * at_b + slack
    assert at_b >= at_a + slope @ (b - a) - slack


def test_enormous_differences_neither_overflow_nor_vanish() -> None:
    blocks = [np.full((3, N_FEATURES), value) for value in (-1e6, 1e6)]
    w = np.full(N_FEATURES, 300.0)
    for config in CONFIGS:
        loss, gradient = PiirlLoss(blocks, config).at(w)
        assert np.isfinite(loss)
        assert np.isfinite(gradient).all()
        if config.with_demonstration:
            assert (gradient > 0.0).all()  # who was worse than all samples is to be told apart no more


@pytest.mark.parametrize("config", CONFIGS)
def test_losses_are_convex(config: PiirlSettings) -> None:
    blocks = [contrast.differences for contrast in made_up()]
    rng = np.random.default_rng(2)
    for _ in range(20):
        a, b = rng.uniform(0.0, 10.0, (2, N_FEATURES))
        middle = PiirlLoss(blocks, config).at(0.5 * (a + b))[0]
        assert middle <= 0.5 * (PiirlLoss(blocks, config).at(a)[0] + PiirlLoss(blocks, config).at(b)[0]) + 1e-9


def test_the_loss_is_what_the_paper_says() -> None:
    blocks = [contrast.differences for contrast in made_up()]
    w = np.random.default_rng(3).uniform(0.0, 1.0, N_FEATURES)
    sums = [np.exp(-differences @ w).sum() for differences in blocks]
    assert PiirlLoss(blocks, PiirlSettings()).at(w)[0] == pytest.approx(np.log(sums).sum())
    both = PiirlLoss(blocks, PiirlSettings(with_demonstration=True)).at(w)[0]
    assert both == pytest.approx(np.log(1.0 + np.array(sums)).sum())
    fined = PiirlLoss(blocks, PiirlSettings(l2=0.4)).at(w)[0]
    assert fined == pytest.approx(np.log(sums).sum() + 3.0 * 0.2 * (w**2).sum())


@pytest.mark.parametrize("config", SOLVED)
def test_the_solution_is_optimal_within_its_bounds(config: PiirlSettings) -> None:
    found = made_up(shift=0.15)
    solution = learn_weights(found, config)
    blocks = [contrast.differences for contrast in found]
    loss, gradient = PiirlLoss(blocks, config).at(solution.weights)
    assert loss == pytest.approx(solution.loss)
    scale = np.concatenate(blocks).std(axis=0)
    inside = np.logical_and(solution.weights > 0.0, ~solution.at_upper)
    assert np.abs(gradient / scale)[inside].max(initial=0.0) < 1e-3  # Karush, Kuhn and Tucker
    assert (gradient / scale)[solution.weights == 0.0].min(initial=0.0) > -1e-3
    assert (gradient / scale)[solution.at_upper].max(initial=0.0) < 1e-3
    again = learn_weights(found, config, start=np.random.default_rng(0).uniform(0.0, 300.0, N_FEATURES))
    assert again.loss == pytest.approx(solution.loss, abs=1e-6)


def test_separable_demonstrations_drive_weights_to_their_bound_and_it_is_reported() -> None:
    found = [Contrast("d", "r", np.abs(made_up(n_demos=1)[0].differences))]
    solution = learn_weights(found, PiirlSettings(upper=7.0))
    assert solution.at_upper.all()
    np.testing.assert_allclose(solution.weights, 7.0)


def test_only_what_is_stopped_from_above_is_reported() -> None:
    """One feature tells the demonstration from its samples, one speaks against it, the others say nothing."""
    differences = np.zeros((50, N_FEATURES))
    rng = np.random.default_rng(0)
    differences[:, 3] = rng.uniform(0.1, 1.0, 50)
    differences[:, 9] = -rng.uniform(0.1, 1.0, 50)
    for config in (PiirlSettings(upper=5.0), PiirlSettings(upper=5.0, normalised=True)):
        solution: PiirlSolution = learn_weights([Contrast("d", "r", differences)], config)
        assert np.flatnonzero(solution.at_upper).tolist() == [3]
        assert solution.weights[9] == 0.0
        assert np.isfinite(solution.weights).all()


def test_normalised_features_do_not_depend_on_their_scale() -> None:
    found = made_up(shift=0.15)
    config = PiirlSettings(normalised=True, with_demonstration=True, l2=0.1)
    factor = 10.0 ** np.random.default_rng(5).uniform(-4.0, 4.0, N_FEATURES)
    scaled = [Contrast(c.demonstration, c.recording, c.differences * factor) for c in found]
    a, b = learn_weights(found, config), learn_weights(scaled, config)
    np.testing.assert_allclose(a.weights, b.weights * factor, rtol=1e-3, atol=1e-6 * a.weights.max())


def test_penalties_make_weights_smaller() -> None:
    found = made_up()
    sums = [learn_weights(found, PiirlSettings(normalised=True, l2=l2)).weights for l2 in (0.01, 1.0)]
    spread = np.concatenate([contrast.differences for contrast in found]).std(axis=0)
    assert (sums[1] * spread).sum() < 0.5 * (sums[0] * spread).sum()


def test_features_that_play_no_part_have_no_weight_and_change_no_other() -> None:
    found = made_up()
    config = PiirlSettings(with_demonstration=True, normalised=True, l2=0.1)
    learned = learn_weights(found, config.replaced(without=DISTANCE_NAMES))
    gone = np.isin(FEATURE_NAMES, DISTANCE_NAMES)
    assert (learned.weights[gone] == 0.0).all()
    assert not learned.at_upper[gone].any()
    blank = [dataclasses.replace(contrast, differences=np.where(gone, 0.0, contrast.differences)) for contrast in found]
    np.testing.assert_allclose(learned.weights[~gone], learn_weights(blank, config).weights[~gone], rtol=1e-4)
    assert learned.weights[~gone].max() > 0.0


def test_weights_behind_noisy_choices_are_found_again() -> None:
    """Who chooses with probability exp(-w . phi) among candidates has these w, to the accuracy of 400 choices."""
    rng = np.random.default_rng(8)
    size = 10.0 ** rng.uniform(-3.0, 0.0, N_FEATURES)
    truth = np.where(rng.random(N_FEATURES) < 0.5, rng.uniform(0.5, 2.0, N_FEATURES), 0.0) / size
    found = []
    for k in range(400):
        phi = size * rng.normal(size=(40, N_FEATURES))
        likely = np.exp(-phi @ truth)
        chosen = int(rng.choice(40, p=likely / likely.sum()))
        found.append(Contrast(f"d{k}", f"r{k}", np.delete(phi, chosen, axis=0) - phi[chosen]))
    config = PiirlSettings(with_demonstration=True, normalised=True)
    learned = learn_weights(found, config).weights
    np.testing.assert_allclose(learned * size, truth * size, atol=0.35)
    assert np.abs((learned - truth) * size).mean() < 0.1


def test_demonstrations_of_a_person_who_avoids_the_partner_show_it() -> None:
    features = ReachFeatures(MODEL, n_waypoints=24)
    truth = np.zeros(N_FEATURES)
    truth[[1, 13]] = 50.0, 10.0  # posture velocity, and wrist to wrist
    demos = [optimal(demonstration(recording(seed), features), features, truth) for seed in range(4)]
    sampling = SamplingSettings(n_samples=300, deviation=1e-2)
    found = contrasts(demos, features, sampling, np.random.default_rng(0))
    learned = learn_weights(found, PiirlSettings(normalised=True, with_demonstration=True, l2=1e-2)).weights
    assert learned[13] > 0.0
    unseen = demonstration(recording(9), features)
    learned = np.where(np.isin(np.arange(N_FEATURES), [1, 13]), learned, 0.0)
    wanted, got = (optimal(unseen, features, w).q for w in (truth, learned))
    assert np.abs(got - wanted).mean() < 0.8 * np.abs(unseen.q - wanted).mean()
    for contrast in found:  # a demonstration is cheaper than nearly everything beside it
        assert (contrast.differences @ learned > 0.0).mean() > 0.95


def optimal(demo: Demonstration, features: ReachFeatures, weights: FloatArray) -> Demonstration:
    """Return the reach of least cost between the demonstration's ends; posture velocity and wrist to wrist only."""
    n, n_dofs = demo.q.shape
    points, dt_s = ChainPoints(MODEL, ["right_wrist"]), demo.situation.duration_s / (n - 1)

    def cost(x: FloatArray) -> tuple[float, FloatArray]:
        q = demo.q.copy()
        q[1:-1] = x.reshape(n - 2, n_dofs)
        padded = np.concatenate([np.repeat(q[:1], 3, axis=0), q, np.repeat(q[-1:], 3, axis=0)])
        velocity = sum(RULES[0][o] * padded[o : o + n] for o in range(7)) / dt_s
        gradient = np.zeros_like(padded)
        for o in range(7):
            gradient[o : o + n] += 2.0 * weights[1] * SCALES[1] * RULES[0][o] * velocity / dt_s
        away = points.positions(q)[:, 0] - demo.situation.partner_m[1]
        d = np.linalg.norm(away, axis=1)
        slope = np.where(d < 0.8, -np.log(6.0) / 0.16 * 5.0 * 6.0 ** (-d / 0.16), 0.0) * dt_s * weights[13] / d
        gradient = gradient[3:-3] + np.einsum("n,ni,nij->nj", slope, away, points.jacobian(q)[:, 0])
        return float(features.values(q, demo.situation) @ weights), gradient[1:-1].ravel()

    assert not np.delete(weights, [1, 13]).any()
    found = minimize(cost, demo.q[1:-1].ravel(), jac=True, method="L-BFGS-B", options={"maxiter": 200})
    q = demo.q.copy()
    q[1:-1] = found.x.reshape(n - 2, n_dofs)
    return Demonstration(demo.recording, demo.first_frame, q, demo.situation)


def test_nothing_to_learn_from_is_refused() -> None:
    with pytest.raises(MotionError, match="at least one demonstration"):
        learn_weights([])


@pytest.mark.parametrize("bad", [{"upper": 0.0}, {"upper": np.inf}, {"l2": -1.0}, {"without": ("nose",)}])
def test_impossible_settings_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=next(iter(bad))):
        PiirlSettings(**bad)  # type: ignore[arg-type]
