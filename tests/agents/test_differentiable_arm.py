"""Tests of arms in PyTorch: gradients against extrapolated differences, descents of a loss, bits of a batch, errors."""

import numpy as np
import pytest

import flexman_gym as fm
from flexman_gym.simulation.batch import Batch
from flexman_gym.simulation.physical_parameters import nominal_parameters

pytest.importorskip("stable_baselines3")
torch = pytest.importorskip("torch")
from flexman_agents.differentiable_arm import DifferentiableArm  # noqa: E402

PERIOD, PERIODS, N = 0.02, 20, 2
GAINS = torch.tensor([[20.0, 10.0], [1.0, 0.3]], dtype=torch.float64)  # N m/rad and N m s/rad of each motor
GOAL = torch.tensor([0.5, -0.2], dtype=torch.float64)


@pytest.fixture(scope="module")
def model():
    """A vertical arm with elastic links, an elastic and a rigid joint, friction and a payload."""
    strip = fm.Link.strip(0.5, 0.04, 0.003)
    first = fm.Joint((0.0, 0.0, 1.0), 0.02, stiffness=60.0, damping=0.05, viscous_friction=0.05, coulomb_friction=0.1,
                     coulomb_rate=0.3)  # fmt: skip
    arm = fm.Arm([strip, strip], [first, fm.Joint((0.0, 0.0, 1.0), 0.01)], fm.Payload(0.1), gravity=(0.0, -9.81, 0.0))
    return fm.build_model(arm, elements=1, modes=1)


@pytest.fixture(scope="module")
def arm(model):
    return DifferentiableArm(model, control_period=PERIOD)


def tensor(values):
    return torch.tensor(np.array(values), dtype=torch.float64)


def start(model, count=2):
    """Return states (count, 2 d) of moving, deformed arms and torques (count, n)."""
    states = np.stack([model.initial_state([0.3, -0.5])] * count)
    states += 0.01 * np.sin(1.0 + np.arange(states.size)).reshape(states.shape)
    return tensor(states), tensor(0.5 * np.cos(np.arange(count * N)).reshape(count, N))


def given_parameters(model, count=2):
    """Return values of parameters beside the nominal ones, for all arms and for each."""
    nominal = nominal_parameters(model)
    each = tensor(1.0 + 0.1 * np.arange(count))
    return {
        "payload_mass": 1.2 * float(nominal["payload_mass"]) * each,
        "joint_stiffness": tensor(0.9 * nominal["joint_stiffness"]),
        "link_stiffness_factor": each[:, None] * tensor([1.3, 0.8]),
    }


def rollout(arm, state, law):
    """Return the loss (b,) of the motion under torques law(angles, rates) of the motors."""
    model, loss = arm.model, 0.0
    motors = torch.as_tensor(model.motor_columns)
    for _ in range(PERIODS):
        angles, rates = state[:, motors], state[:, model.n_dof + motors]
        state, outputs = arm.step(state, law(angles, rates))
        loss = loss + (outputs[:, :2] - GOAL).square().sum(dim=1) + 0.01 * outputs[:, 3:5].square().sum(dim=1)
    return loss


def pd(gains):
    """Return a PD law with gains (..., 2, n)."""
    return lambda angles, rates: gains[..., 0, :] * (GOAL - angles) - gains[..., 1, :] * rates


def network():
    torch.manual_seed(3)
    return torch.nn.Sequential(torch.nn.Linear(2 * N, 4), torch.nn.Tanh(), torch.nn.Linear(4, N)).double()


def policy(net):
    return lambda angles, rates: 2.0 * net(torch.cat([angles, 0.1 * rates], dim=1))


def extrapolated(function, step):
    """Return the derivative of a function at 0 from central differences extrapolated to order six."""
    parts = [weight / (2.0 * k * step) * (function(k * step) - function(-k * step))
             for k, weight in ((1, 1.5), (2, -0.6), (3, 0.1))]  # fmt: skip
    return sum(parts)


def test_steps_have_the_bits_of_a_batch(model, arm):
    states, torques = start(model, 3)
    parameters = given_parameters(model, 3)
    batch = Batch(model, control_period=PERIOD, arms=3)
    shaped = {name: np.broadcast_to(each, (3, *nominal_parameters(model)[name].shape)) for name, each in
              parameters.items()}  # fmt: skip
    batch.vary(np.arange(3), **shaped)
    batch.reset(np.arange(3), states.numpy())
    batch.step(np.hstack([torques, np.zeros((3, 6))]))
    for given in (torques, torques.clone().requires_grad_()):
        state, outputs = arm.step(states, given, **parameters)
        assert np.array_equal(state.detach(), batch.state) and np.array_equal(outputs.detach(), batch.outputs)
        assert state.requires_grad == given.requires_grad
    plain = arm.step(states, torques)[0]
    assert torch.equal(plain, arm.step(states, torques.clone().requires_grad_())[0]) and not torch.equal(plain, state)


@pytest.mark.slow
def test_gradients_are_those_of_differences(model, arm):
    states, torques = start(model)
    parameters = given_parameters(model)
    inputs = [each.clone().requires_grad_() for each in (states, torques, *parameters.values())]

    def step(state, torque, mass, stiffness, factor):
        stiffness = stiffness * tensor([1.0, 0.0])  # the second joint is rigid
        return arm.step(state, torque, payload_mass=mass, joint_stiffness=stiffness, link_stiffness_factor=factor)

    assert torch.autograd.gradcheck(step, inputs, eps=1e-6, atol=1e-6, rtol=1e-5)


def test_a_second_derivative_is_refused(model, arm):
    inputs = [each.requires_grad_() for each in start(model)]
    with pytest.raises(RuntimeError, match="create_graph: an arm has derivatives of first order only"):
        torch.autograd.gradgradcheck(arm.step, inputs)


@pytest.mark.slow
def test_gradients_of_gains_through_a_rollout_are_extrapolated_differences(model, arm):
    states, _ = start(model)
    gains = GAINS.clone().requires_grad_()
    rollout(arm, states, pd(gains)).sum().backward()
    for index in np.ndindex(2, N):
        change = torch.zeros_like(GAINS)
        change[index] = GAINS[index]
        with torch.no_grad():
            best = extrapolated(lambda x, change=change: rollout(arm, states, pd(GAINS + x * change)).sum(), 3e-3)
        torch.testing.assert_close(gains.grad[index] * GAINS[index], best, rtol=1e-9, atol=0.0)


def test_gradients_of_weights_through_a_rollout_are_extrapolated_differences(model, arm):
    states, _ = start(model)
    net = network()
    rollout(arm, states, policy(net)).sum().backward()
    for parameter in net.parameters():
        direction, values = torch.randn_like(parameter), parameter.detach().clone()

        def loss(x, parameter=parameter, direction=direction, values=values):
            parameter.data = values + x * direction
            return rollout(arm, states, policy(net)).sum()

        with torch.no_grad():
            best = extrapolated(loss, 3e-3)
        parameter.data = values
        torch.testing.assert_close((parameter.grad * direction).sum(), best, rtol=1e-7, atol=0.0)


@pytest.mark.parametrize("law", ["pd", "policy"])
def test_a_small_step_along_the_gradient_lowers_the_loss_as_predicted(law, model, arm):
    states, _ = start(model)
    net = network() if law == "policy" else torch.nn.ParameterList([GAINS.clone()])
    make = policy if law == "policy" else lambda gains: pd(gains[0])
    before = rollout(arm, states, make(net)).sum()
    before.backward()
    square = sum(each.grad.square().sum() for each in net.parameters())
    errors = []
    for share in (1e-3, 1e-4):
        rate, values = share * before.item() / square, [each.detach().clone() for each in net.parameters()]
        with torch.no_grad():
            for each in net.parameters():
                each -= rate * each.grad
            decrease = before.item() - rollout(arm, states, make(net)).sum().item()
            for each, value in zip(net.parameters(), values, strict=True):
                each.copy_(value)
        errors.append(abs(decrease / (share * before.item()) - 1.0))
    assert errors[1] < 0.01 and errors[1] < 0.15 * errors[0], errors


def test_a_divergence_names_the_arms(model, arm):
    states, torques = start(model, 3)
    torques[1] = 1e12
    for given in (torques, torques.clone().requires_grad_()):
        with pytest.raises(RuntimeError, match=r"arms \[1\] diverge in this control period; give smaller torques"):
            arm.step(states, given)
    arm.step(states, 0.0 * torques)


def test_bad_arguments_are_refused_in_one_line(model, arm):
    states, torques = start(model)
    for arguments, words in (
        ({"state": states[0]}, "state: (10,) is not allowed; give a tensor of shape (1, 10)"),
        ({"state": states.float()}, "state: 'torch.float32 on cpu' is not allowed; give a float64 tensor on the CPU"),
        ({"state": states.numpy()}, "give a float64 tensor on the CPU"),
        ({"torque": torques[:1]}, "torque: (1, 2) is not allowed; give a tensor of shape (2, 2)"),
        ({"payload": tensor(1.0)}, "parameters: 'payload' is not allowed"),
        ({"payload_mass": tensor([1.0, 2.0, 3.0])}, "payload_mass: (3,) is not allowed; give a tensor of"),
        ({"payload_mass": tensor(-1.0)}, "is not allowed; give finite numbers >= 0"),
        ({"joint_stiffness": tensor([60.0, 60.0])}, "for joints [1]: rigid"),
    ):  # fmt: skip
        for given in (False, True):
            keywords = {"state": states, "torque": torques.clone().requires_grad_(given), **arguments}
            with pytest.raises(ValueError) as raised:
                arm.step(**keywords)
            assert words in str(raised.value) and "\n" not in str(raised.value)
    with pytest.raises(ValueError, match="method: 'dop853' is not allowed"):
        DifferentiableArm(model, "dop853")
