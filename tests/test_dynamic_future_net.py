"""The Dynamic Future Net's three stages: each part against what it must be, and what each stage learns."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import torch
from torch.distributions import Independent, Normal, kl_divergence

from tutorial_lib import data
from tutorial_lib.errors import TutorialError
from tutorial_lib.models.dynamic_future_net import STAGES, DynamicFutureNet, DynamicFutureNetConfig
from tutorial_lib.models.future_code import FutureCode, sequence_error, smoothness_error
from tutorial_lib.models.layers import Standardizer, mlp
from tutorial_lib.models.pose_code import pose_error
from tutorial_lib.models.stochastic_latent import BOUND, Gaussian, StochasticLatent, gaussian
from tutorial_lib.motion import to_common
from tutorial_lib.representations import make_representation, representation_from_config
from tutorial_lib.training.future_loss import (
    DynamicFutureLoss,
    code_likelihood,
    current_divergence,
    future_divergence,
    skip_steps,
    summary_likelihood,
    temporal_difference,
)
from tutorial_lib.training.systems import make_system

SIZES = {"hidden": 12, "horizon": 3, "code": 6, "velocity_code": 2, "summary": 5, "current": 4, "future": 3}


@pytest.fixture(scope="module")
def clip():
    return to_common(data.load("samples/walking")[0])[:80]


@pytest.fixture(scope="module")
def representation(clip):
    return make_representation("body-frame", clip.skeleton, clip.fps)


@pytest.fixture
def network(representation):
    values = {**SIZES, "features": representation.config()}
    return make_system("dynamic-future-net", representation.dim, seed=3, **values).model


@pytest.fixture(scope="module")
def windows(clip, representation):
    features = torch.from_numpy(representation.encode(clip))
    return torch.stack([features[k : k + 12] for k in (0, 20, 40)])  # (3, 12, D)


def normals(*shape, seed=0) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def torch_normal(g: Gaussian) -> Independent:
    return Independent(Normal(g.mean, (0.5 * g.log_variance).exp()), 1)


# --- body-frame features ----------------------------------------------------------------------------------


def test_body_frame_has_the_papers_numbers(representation, clip):
    """Section 4: 3 J joint positions, x-z velocity, turning and height change."""
    assert representation.dim == 3 * 21 + 4 and representation.labels[-4:] == (
        "turning", "forward", "sideways", "rising",
    )  # fmt: skip
    features = representation.encode(clip)
    hip_frame = make_representation("hip-frame", clip.skeleton, clip.fps)
    np.testing.assert_array_equal(features[:, :-1], hip_frame.encode(clip))
    height = clip.positions[:, representation.hip, 1]
    np.testing.assert_allclose(features[1:, -1], np.diff(height) * clip.fps, atol=1e-5)
    assert representation_from_config(json.loads(json.dumps(representation.config()))) == representation


def test_a_motion_by_rotations_is_the_motion_by_positions(representation, clip):
    """``decode_turned`` gives the rotations that make the very positions which the features tell."""
    motion = clip.rotate_y(0.7).translate((1, 0, 2))
    features = representation.encode(motion)
    heading = np.arctan2(*np.moveaxis(_facing(representation, motion), -1, 0))
    local = motion.rotations.copy()
    from tutorial_lib.motion.rotations import quat_about_y, quat_mul

    local[:, 0] = quat_mul(quat_about_y(-heading), local[:, 0])
    made = representation.decode_turned(features, local, **representation.origin(motion))
    rigid = motion.skeleton.fk(motion.rotations, motion.positions[:, 0])
    np.testing.assert_allclose(made.positions, rigid, atol=1e-4)


def _facing(representation, motion) -> np.ndarray:
    """(T, 2) sine and cosine of the heading, from the definition: across hips and shoulders, turned by a quarter."""
    at = {name: motion.skeleton.index(name) for name in ("LeftUpLeg", "RightUpLeg", "LeftArm", "RightArm")}
    p = motion.positions
    left = p[:, at["LeftUpLeg"]] - p[:, at["RightUpLeg"]] + p[:, at["LeftArm"]] - p[:, at["RightArm"]]
    forward = np.cross(left, (0, 1, 0))
    return forward[:, [0, 2]]


# --- stage 1 ----------------------------------------------------------------------------------------------


def test_bones_keep_their_length_whatever_the_code(network):
    skeleton = network.representation.skeleton
    pose = network.pose.decode(50 * normals(200, 6))
    joints = network.pose.features(pose)[:, : 3 * skeleton.n_joints].unflatten(-1, (-1, 3))
    parent, child = skeleton.bones.T.tolist()
    lengths = (joints[:, child] - joints[:, parent]).norm(dim=-1)
    assert (lengths - torch.tensor(skeleton.bone_lengths)).abs().max() < 1e-5
    assert lengths.std() > 0.01, "or every bone is as long as the next, and nothing is tested"


def test_forward_kinematics_is_the_skeletons(network):
    skeleton, hip = network.representation.skeleton, network.representation.hip
    pose = network.pose.decode(normals(7, 6))
    joints = network.pose.features(pose)[:, : 3 * skeleton.n_joints].unflatten(-1, (-1, 3)).detach().numpy()
    expected = skeleton.fk(pose.rotations.detach().double().numpy(), np.zeros((7, 3)))
    expected = expected - expected[:, [hip]] + np.array([0, 1, 0]) * pose.height.detach().numpy()[:, None]
    np.testing.assert_allclose(joints, expected, atol=1e-5)
    np.testing.assert_allclose(joints[:, hip][:, [0, 2]], 0, atol=1e-7)
    np.testing.assert_allclose(pose.rotations.norm(dim=-1).detach(), 1, atol=1e-6)
    leaves = [j for j in range(skeleton.n_joints) if not skeleton.children[j]]
    assert leaves and torch.equal(pose.rotations[:, leaves, 0], torch.ones(7, len(leaves))), "they turn nothing"


def test_pose_and_velocity_have_codes_of_their_own(network):
    code = normals(5, 6)
    other = code.clone()
    other[:, -2:] += 1  # the velocity's
    one, two = network.pose.decode(code), network.pose.decode(other)
    assert torch.equal(one.rotations, two.rotations) and torch.equal(one.height, two.height)
    assert not torch.allclose(one.velocity, two.velocity)
    other = code.clone()
    other[:, :-2] += 1
    assert torch.equal(one.velocity, network.pose.decode(other).velocity)


def test_a_centimetre_counts_the_same_everywhere(network, windows):
    network.pose.fit_features([windows])
    joints, moving = (network.representation.slices[part] for part in ("joints", "velocity"))
    assert len(set(network.pose.unit[joints].tolist())) == 1
    deviations = windows.flatten(0, 1)[:, moving].std(0, correction=0)
    torch.testing.assert_close(network.pose.unit[moving], deviations.clamp_min(1e-3))


def test_pose_error_by_hand():
    x = torch.tensor([[[0.0, 0], [1, 1]]])
    made = torch.tensor([[[3.0, 0], [1, 5]]])
    assert float(pose_error(x, made, torch.tensor([1.0, 2.0]))) == (9 + 4) / 2


def test_standardizer():
    x = 5 + 3 * normals(4, 50, 2)
    scale = Standardizer(2)
    assert torch.equal(scale(x), x), "it changes nothing before it is fitted"
    scale.fit([x[:1], x[1:]])
    y = scale(x).flatten(0, 1)
    torch.testing.assert_close(y.mean(0), torch.zeros(2), atol=1e-5, rtol=0)
    torch.testing.assert_close(y.std(0, correction=0), torch.ones(2))
    torch.testing.assert_close(scale.invert(scale(x)), x)


def test_mlp_counts_its_layers():
    sizes = [tuple(layer.weight.shape) for layer in mlp(3, 8, 2, 4) if hasattr(layer, "weight")]
    assert sizes == [(8, 3), (8, 8), (8, 8), (2, 8)]


# --- stage 2 ----------------------------------------------------------------------------------------------


def test_sequences_are_the_stretches_that_fit():
    codes = torch.arange(2 * 7 * 1.0).view(2, 7, 1)
    found = FutureCode(code=1, summary=2, horizon=3, hidden=4).sequences(codes)
    assert found.shape == (2, 4, 4, 1)
    assert found[1, 2, :, 0].tolist() == [9, 10, 11, 12]


def test_a_summary_sees_its_future_and_nothing_else(network):
    codes = normals(1, 9, 6)
    summaries = network.future.summaries(codes)
    assert summaries.shape == (1, 6, 5)
    other = codes.clone()
    other[:, 5] += 1
    changed = (network.future.summaries(other) - summaries).abs().amax(-1)[0] > 1e-6
    assert changed.tolist() == [False, False, True, True, True, True], "frame 5 is in the futures of 2 to 5, H = 3"
    assert network.future.decode(summaries[0], codes[0, :6]).shape == (6, 3, 6)


def test_sequence_and_smoothness_error_by_hand():
    assert float(sequence_error(torch.zeros(1, 2, 2), torch.tensor([[[3.0, 4], [0, 1]]]))) == (25 + 1) / 2
    truth, made = torch.tensor([[[0.0], [1], [3]]]), torch.tensor([[[5.0], [6], [4]]])
    assert float(smoothness_error(truth, made)) == (0 + 16) / 2, "velocities 1, 2 and 1, -2: not places"


# --- stage 3: distributions ----------------------------------------------------------------------------------


def test_gaussians_are_what_torch_says():
    g = gaussian(normals(4, 6, seed=1))
    p = gaussian(normals(4, 6, seed=2))
    expected = kl_divergence(torch_normal(g), torch_normal(p)).mean()
    torch.testing.assert_close(current_divergence(g, p), expected)
    torch.testing.assert_close(future_divergence(g, p), expected)
    assert float(current_divergence(p, p)) == 0 and float(future_divergence(g, g)) == 0
    draws = Gaussian(*(x.expand(20_000, 4, 3) for x in g)).sample(torch.Generator().manual_seed(0))
    torch.testing.assert_close(draws.mean(0), g.mean, atol=0.05, rtol=0.05)
    torch.testing.assert_close(draws.var(0), g.log_variance.exp(), atol=0.05, rtol=0.05)
    wild = gaussian(torch.tensor([0.0, 1e9])), gaussian(torch.tensor([0.0, -1e9]))
    assert [float(w.log_variance) for w in wild] == [BOUND, -BOUND]


def test_temperature_is_a_factor_of_the_deviation():
    g = Gaussian(torch.tensor([2.0]), torch.tensor([1.0]))
    one, three = (g.at_temperature(t).sample(torch.Generator().manual_seed(0)) - 2 for t in (1.0, 3.0))
    torch.testing.assert_close(three, 3 * one)
    assert float(g.at_temperature(0.0).sample(torch.Generator().manual_seed(0))) == 2


def test_likelihoods_are_log_probabilities_but_for_a_constant():
    x, one, two = (normals(2, 3, 4, seed=k).double() for k in range(3))
    for term, deviation in ((code_likelihood, 0.1), (summary_likelihood, 0.3)):
        truth = [-Normal(mean, deviation).log_prob(x).sum(-1).mean() for mean in (one, two)]
        torch.testing.assert_close(term(x, one, deviation) - term(x, two, deviation), truth[0] - truth[1])


def test_sizes_are_the_papers():
    """Section 5.3: layers and their hidden units, and a GRU of two layers of 128."""
    dynamics = StochasticLatent()
    layers = {name: [m.out_features for m in getattr(dynamics, name) if hasattr(m, "out_features")][:-1] for name in (
        "future_prior", "summary_decoder", "current_prior", "code_decoder", "current_posterior", "future_posterior",
        "earlier_posterior", "skip_decoder",
    )}  # fmt: skip
    assert layers == {
        "future_prior": [256, 256], "summary_decoder": [128] * 3, "current_prior": [128], "code_decoder": [128] * 3,
        "current_posterior": [32, 32], "future_posterior": [512, 512], "earlier_posterior": [32, 32],
        "skip_decoder": [32] * 3,
    }  # fmt: skip
    assert [cell.hidden_size for cell in dynamics.cells] == [128, 128]


def test_inference_runs_along_the_graph(network):
    """Figure 5 b and c, a step at a time with the means (no chance): h_t comes from what was before t."""
    dynamics = network.dynamics
    codes, summaries = normals(2, 4, 6), normals(2, 4, 5, seed=1)
    seen = dynamics.infer(codes, summaries, torch.Generator().manual_seed(0))
    noise, state = torch.Generator().manual_seed(0), dynamics.start(2)
    for t in range(4):
        torch.testing.assert_close(seen.past[:, t], state[1])
        q_f = dynamics.posterior_future(state[1], summaries[:, t])
        f = q_f.mean + (q_f.log_variance / 2).exp() * torch.randn(2, 3, generator=noise)
        q_s = dynamics.posterior_current(state[1], codes[:, t], summaries[:, t])
        s = q_s.mean + (q_s.log_variance / 2).exp() * torch.randn(2, 4, generator=noise)
        torch.testing.assert_close((seen.future[:, t], seen.current[:, t]), (f, s))
        torch.testing.assert_close(seen.posterior_current.mean[:, t], q_s.mean)
        x = torch.cat((s, f), -1)
        first = dynamics.cells[0](x, state[0])
        state = first, dynamics.cells[1](first, state[1])
    assert seen.past[:, 0].abs().max() == 0 and seen.past.shape == (2, 4, 12)


# --- stage 3: the loss -----------------------------------------------------------------------------------------


def test_skips_stay_inside_the_sequence():
    steps = skip_steps(500, 9, 4, torch.Generator().manual_seed(0))
    assert steps.shape == (500, 8) and steps.min() == 1
    later = torch.arange(8) + steps
    assert later.max() == 8
    assert [int(steps[:, k].max()) for k in range(8)] == [4, 4, 4, 4, 4, 3, 2, 1]
    assert set(steps[:, 0].tolist()) == {1, 2, 3, 4}


def test_temporal_difference_pair_by_pair(network):
    """Equations 12 to 14 and the second half of 15, worked out for each pair alone."""
    dynamics = network.dynamics
    s, h = normals(2, 4, 4), normals(2, 4, 12, seed=1)
    prior = Gaussian(normals(2, 4, 4, seed=2), normals(2, 4, 4, seed=3))
    steps = torch.tensor([[2, 1, 1], [3, 2, 1]])
    found = temporal_difference(dynamics, s, h, prior, steps, 3, torch.Generator().manual_seed(5))
    noise = torch.randn(2, 3, 4, generator=torch.Generator().manual_seed(5))
    total = 0.0
    for b in range(2):
        for t1 in range(3):
            dt = int(steps[b, t1])
            t2 = t1 + dt
            numbers = dynamics.earlier_posterior(torch.cat((s[b, t2], h[b, t1], h[b, t2])))
            mean, log_variance = numbers[:4], 6 * torch.tanh(numbers[4:] / 6)
            q = Normal(mean, (log_variance / 2).exp())  # (13)
            p = Normal(prior.mean[b, t1], (prior.log_variance[b, t1] / 2).exp())
            earlier = q.mean + q.stddev * noise[b, t1]
            again = dynamics.skip_decoder(torch.cat((earlier, torch.tensor([dt / 3]))))  # (14)
            likelihood = Normal(again, 1.0).log_prob(s[b, t2]).sum() + 2 * math.log(2 * math.pi)
            total = total + kl_divergence(q, p).sum() - likelihood
    torch.testing.assert_close(found, total / 6)


def learnt(model: DynamicFutureNet) -> set[str]:
    return {name for name, p in model.named_parameters() if p.grad is not None and p.grad.abs().max() > 0}


@pytest.mark.parametrize("stage", STAGES)
def test_gradients_reach_the_stages_own_weights_all_of_them(network, windows, stage):
    network.pose.fit_features([windows])
    loss = {"pose": "pose_loss", "future": "trajectory_loss", "dynamics": "dynamics_loss"}[stage]
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(name.startswith(stage + "."))
    value, terms = getattr(DynamicFutureLoss(), loss)(network, windows, torch.Generator().manual_seed(0))
    value.backward()
    assert learnt(network) == {name for name, _ in network.named_parameters() if name.startswith(stage + ".")}
    assert all(not term.requires_grad and torch.isfinite(term) for term in terms.values())


def test_the_loss_is_the_sum_of_its_terms(network, windows):
    def run(**options):
        loss = DynamicFutureLoss(**options)
        return loss.dynamics_loss(network, windows, torch.Generator().manual_seed(0))

    value, terms = run()
    assert set(terms) == {"current divergence", "code", "future divergence", "summary", "temporal difference"}
    torch.testing.assert_close(value.detach(), sum(terms.values()))
    without, terms = run(temporal=0.0)
    assert "temporal difference" not in terms and without < value
    torch.testing.assert_close(run(temporal=2.0)[0] - value, value - without)


def test_without_a_future_state(representation, windows):
    """The ablation: neither f nor m has any part in the network."""
    values = {**SIZES, "future": 0, "features": representation.config()}
    network = make_system("dynamic-future-net", representation.dim, seed=3, **values).model
    network.pose.fit_features([windows])
    value, terms = DynamicFutureLoss().dynamics_loss(network, windows, torch.Generator().manual_seed(0))
    assert set(terms) == {"current divergence", "code", "temporal difference"} and torch.isfinite(value)
    dynamics = network.dynamics
    one, two = (dynamics.infer(normals(2, 4, 6), normals(2, 4, 5, seed=k), torch.Generator().manual_seed(0)).past
                for k in (1, 2))  # fmt: skip
    assert torch.equal(one, two), "summaries are not looked at"


# --- what cannot be ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("values, told", [
    ({"code": 4, "velocity_code": 4}, "leaves none for the pose"),
    ({"horizon": 0}, "horizon must be a whole number of 1 or more, not 0"),
    ({"future": -1}, "future must be a whole number of 0 or more"),
    ({"features": None}, "must be told"),
    ({"size": 3}, "has no size or option 'size'"),
])  # fmt: skip
def test_sizes_that_cannot_be(representation, values, told):
    given = {**SIZES, "features": representation.config(), **values}
    with pytest.raises(TutorialError, match=told):
        make_system("dynamic-future-net", representation.dim, **given)


def test_features_of_another_kind(representation, clip):
    other = make_representation("hip-frame", clip.skeleton, clip.fps)
    with pytest.raises(TutorialError, match="reads 'body-frame' features"):
        DynamicFutureNet(DynamicFutureNetConfig(other.dim, other.config()))
    with pytest.raises(TutorialError, match="of 60 numbers a frame"):
        DynamicFutureNet(DynamicFutureNetConfig(60, representation.config()))


@pytest.mark.parametrize("values, told", [
    ({"stage": "last"}, "unknown stage 'last': expected one of all, pose, future, dynamics"),
    ({"pose_share": 0.6, "future_share": 0.4}, "some left for dynamics"),
    ({"temporal": -1}, "temporal must be a number of 0 or more"),
    ({"code_deviation": 0}, "code_deviation is a standard deviation above 0"),
])  # fmt: skip
def test_losses_that_cannot_be(values, told):
    with pytest.raises(TutorialError, match=told):
        DynamicFutureLoss(**values)


def test_what_a_perceptron_reads_and_writes_is_standardised(network, windows):
    """Stage 1 by hand: features, codes, height and velocity in the units of the data, rotations about none."""
    pose, representation = network.pose, network.representation
    pose.fit_features([windows])
    pose.fit_codes([windows])
    x = windows.flatten(0, 1)
    mean, std = x.mean(0), x.std(0, correction=0).clamp_min(1e-3)
    raw = pose.encoder((x - mean) / std)
    code = (raw - raw.mean(0)) / raw.std(0, correction=0)
    torch.testing.assert_close(pose.encode(x), code, atol=1e-3, rtol=1e-3)
    made = pose.decode(code)
    numbers, y = pose.quaternion_decoder(raw[:, :-2]), 3 * representation.hip + 1
    torch.testing.assert_close(made.height, numbers[:, -1:] * std[y] + mean[y], atol=1e-4, rtol=1e-3)
    moving = representation.slices["velocity"]
    velocity = pose.velocity_decoder(raw[:, -2:]) * std[moving] + mean[moving]
    torch.testing.assert_close(made.velocity, velocity, atol=1e-4, rtol=1e-3)
    q = numbers[:, :-1].unflatten(-1, (-1, 4)) + torch.tensor([1.0, 0, 0, 0])
    turning = [j for j, children in enumerate(representation.skeleton.children) if children]
    torch.testing.assert_close(made.rotations[:, turning], q / q.norm(dim=-1, keepdim=True), atol=1e-4, rtol=1e-3)
    joints = representation.slices["joints"]
    torch.testing.assert_close(pose.unit[0], std[joints].square().mean().sqrt())


def test_stage_1_is_trained_with_equation_2(network, windows):
    """In units of the data; the term beside it is in metres a joint."""
    network.pose.fit_features([windows])
    value, terms = DynamicFutureLoss().pose_loss(network, windows)
    made = network.pose(windows)
    torch.testing.assert_close(value, ((windows - made) / network.pose.unit).square().sum(-1).mean())
    off = (made - windows)[..., network.representation.slices["joints"]].unflatten(-1, (-1, 3))
    torch.testing.assert_close(terms["joint error"], off.square().sum(-1).sqrt().mean().detach())


def test_a_future_is_unrolled_a_step_at_a_time(network):
    """Figure 4: the decoder reads its own last code and tells what changes, from a summary that is standardised."""
    future, codes = network.future, normals(2, 9, 6)
    future.fit_summaries([codes])
    summary, code = future.summaries(codes).flatten(0, 1), codes[:, :6].flatten(0, 1)
    torch.testing.assert_close(summary.mean(0), torch.zeros(5), atol=1e-4, rtol=0)
    torch.testing.assert_close(summary.std(0, correction=0), torch.ones(5), atol=1e-3, rtol=1e-3)
    unrolled = future.decode(summary, code)
    state = torch.tanh(future.from_summary(summary * future.scale.std + future.scale.mean))
    for t in range(3):
        state = future.decoder(code, state)
        code = code + future.readout(state)
        torch.testing.assert_close(unrolled[:, t], code)


def test_stage_2_is_trained_with_equation_3(network, windows):
    """Sequences by hand: H = 3, and one begins at every frame, as half of that is; joints in units of the data."""
    network.pose.fit_features([windows])
    network.pose.fit_codes([windows])
    value, terms = DynamicFutureLoss(smooth=2.0).trajectory_loss(network, windows)
    pose, future, joints = network.pose, network.future, network.representation.slices["joints"]
    rec, smooth = [], []
    for x in windows:
        z = pose.encode(x)
        for t in range(len(x) - 3):
            made = future.decode(future.encode(z[None, t : t + 4]), z[None, t])[0]  # (3, C)
            rec.append((made - z[t + 1 : t + 4]).square().sum(-1).mean())
            whole = pose.features(pose.decode(torch.cat((z[t : t + 1], made))))
            gap = ((whole - x[t : t + 4]) / pose.unit)[:, joints]
            smooth.append((gap[1:] - gap[:-1]).square().sum(-1).mean())
    torch.testing.assert_close(terms["reconstruction"], torch.stack(rec).mean().detach())
    torch.testing.assert_close(terms["smoothness"], torch.stack(smooth).mean().detach(), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(value.detach(), terms["reconstruction"] + 2.0 * terms["smoothness"])


def test_stage_3_is_trained_with_equation_15(network, windows):
    """Each term by hand, from what inference gives: the prior of s has the imagined summary, not the true one."""
    network.pose.fit_features([windows])
    network.pose.fit_codes([windows])
    loss = DynamicFutureLoss(code_deviation=0.2, summary_deviation=0.7, temporal=0.0)
    _, terms = loss.dynamics_loss(network, windows, torch.Generator().manual_seed(0))
    dynamics = network.dynamics
    codes = network.pose.encode(windows)
    m, z = network.future.summaries(codes), codes[:, :9]  # 12 frames, of which the last 3 are only a future
    seen = dynamics.infer(z, m, torch.Generator().manual_seed(0))
    h = seen.past
    imagined = dynamics.summary_decoder(torch.cat((seen.future, h), -1))
    prior_f, prior_s = (
        gaussian(dynamics.future_prior(h)),
        gaussian(dynamics.current_prior(torch.cat((h, imagined), -1))),
    )
    code = dynamics.code_decoder(torch.cat((seen.current, h), -1))
    wanted = {
        "current divergence": kl_divergence(torch_normal(seen.posterior_current), torch_normal(prior_s)).mean(),
        "future divergence": kl_divergence(torch_normal(seen.posterior_future), torch_normal(prior_f)).mean(),
        "code": (z - code).square().sum(-1).mean() / (2 * 0.2**2),
        "summary": (m - imagined).square().sum(-1).mean() / (2 * 0.7**2),
    }
    assert set(terms) == set(wanted)
    for name, value in wanted.items():
        torch.testing.assert_close(terms[name], value.detach(), rtol=1e-4, atol=1e-5, msg=lambda text, n=name: n + text)


def test_without_a_future_state_the_summary_is_nothing_at_synthesis_too(representation):
    values = {**SIZES, "future": 0, "features": representation.config()}
    dynamics = make_system("dynamic-future-net", representation.dim, seed=3, **values).model.dynamics
    past = normals(4, 12)
    future = dynamics.draw_future(past, None)
    assert future.shape == (4, 0) and torch.equal(dynamics.summary_of(future, past), torch.zeros(4, 5))


def test_sizes_are_those_asked_for_in_every_stage(representation):
    values = {**SIZES, "layers": 3, "features": representation.config()}
    model = make_system("dynamic-future-net", representation.dim, seed=3, **values).model
    assert [cell.hidden_size for cell in model.dynamics.cells] == [12] * 3
    assert model.future.encoder.hidden_size == model.future.decoder.hidden_size == 12


def test_stages_have_their_shares_of_the_steps():
    loss = DynamicFutureLoss(pose_share=0.5, future_share=0.1)
    shares = {stage.name: stage.share for stage in loss.stages()}
    assert shares == pytest.approx({"pose": 0.5, "future": 0.1, "dynamics": 0.4})
    assert [stage.share for stage in DynamicFutureLoss(stage="future").stages()] == [1.0]
