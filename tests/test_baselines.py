"""Baselines: the tools they are made of against closed forms, their limits on any road, their answer to any solver."""

import math
import pickle
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from isd_gym.baselines._estimator import Estimator
from isd_gym.baselines._qp import Osqp, Outcome
from isd_gym.baselines.controller import clean
from isd_gym.baselines.friction import (
    FrictionMpc,
    FrictionMpcSettings,
    _empty_feedback,
    _empty_path,
    _friction,
    _plan,
    _roll,
)
from isd_gym.baselines.lqg import Lqg, LqgSettings
from isd_gym.baselines.mpc import Mpc, MpcSettings
from program import refused

from isd_gym import (
    ISDSuspensionVectorEnv,
    Network,
    StageCost,
    baselines,
    linearise,
    score,
)
from isd_gym.benchmark.scoring import Entry
from isd_gym.physics.prediction import (
    Sensors,
    Weights,
    equivalent_damping,
    move_regulator,
    prediction_model,
    statistical_linearisation,
)
from isd_gym.physics.vehicle import CURRENT_LIMIT, SLEW_LIMIT

STEP = 5e-3
CAR = Network.load("quarter-car-isd")
OWN = [
    n for n in baselines.CONTROLLERS if n not in baselines.WHOLE_CAR
]  # of a quarter car
SEVERAL = ["mpc-friction", *baselines.WHOLE_CAR]  # of several corners, too
MEASURED = [n for n in OWN if n not in ("lqr-full", "mpc-friction-preview")]


def frictionless(net=CAR):
    kept = tuple(e for e in net.elements if e.name not in ("seal", "end_stop"))
    return replace(net, elements=kept, uncertainty={})


def rollout(controller, *, cars=4, steps=400, seed=0, **options):
    """Observations (steps, cars, 6+) and commands (steps, cars) of a controller on the road."""
    options |= {"autoreset_mode": "disabled", "observation": controller.observation}
    env = ISDSuspensionVectorEnv(cars, **options)
    obs, _ = env.reset(seed=seed)
    controller.reset_batch(cars)
    seen, sent = [], []
    for _ in range(steps):
        command = controller.act_batch(obs)
        seen.append(obs)
        sent.append(np.array(command))
        obs, *_ = env.step(np.reshape(command, (cars, 1)))
    return np.array(seen), np.array(sent)


def broken(status):
    """A solver that finds nothing."""
    return SimpleNamespace(solve=lambda *_: Outcome(None, status))


def cost_change(controller, *, cars=8, duration=10.0):
    """Relative change of the cost against the conventional passive car, on the same roads."""
    found = score(
        [Entry("own", lambda: controller)], CAR, episodes=cars, duration=duration
    )
    return found.policies[-1]["cost"]["change"]


def test_prediction_model_is_the_linearised_network():
    """Frequency response of the discrete model at 1 Hz, current to body acceleration, against the continuous one."""
    net = frictionless()
    m, ss = prediction_model(net, 1e-4), linearise(net)
    s = 2j * math.pi
    z = np.exp(s * m.step)
    hold = (1 - np.exp(-s * m.step)) / (s * m.step)
    own = (
        (m.C @ np.linalg.solve(z * np.eye(m.n) - m.A, m.B) + m.D)[:2]
        * hold
        * np.exp(s * m.step) ** 0
    )
    column = ss.inputs.index("current")
    want = ss.response(np.array([1.0]))[0, :2, column]
    assert np.abs(own / want - 1).max() < 2e-3


def test_statistical_linearisation_is_self_consistent():
    weights = Weights(StageCost(), move=0.05, centring=0.05)
    found = statistical_linearisation(CAR, STEP, weights)
    m = found.model
    K, _ = move_regulator(m, weights)
    A = np.zeros((m.n + 1,) * 2)
    A[:-1, :-1], A[:-1, -1], A[-1, -1] = m.A, m.B, 1.0
    A -= np.outer(np.append(m.B, 1.0), K)
    S = np.zeros_like(A)
    for _ in range(20_000):
        S = A @ S @ A.T
        S[:-1, :-1] += m.W
    row = np.append(prediction_model(CAR, STEP).S[0], 0.0)
    assert math.sqrt(row @ S @ row) == pytest.approx(found.rate_rms["seal"], rel=0.01)
    assert found.damping["seal"] == pytest.approx(
        equivalent_damping(500.0, found.rate_rms["seal"]), rel=0.01
    )


def test_estimate_on_the_car_is_the_state():
    """On the real car, friction and all. What the road did within the last 5 ms no sensor has seen yet: 1.4 mm, 270 N
    of tyre load, of which a part is missing; everything else is within a few per cent of its RMS."""
    full = baselines.make("lqr-full")
    seen, _ = rollout(full, steps=1500)
    filter_ = Estimator(full.prediction, Sensors(), 300.0)
    filter_.reset(seen.shape[1])
    errors, truth = [], []
    for obs in seen:
        estimate = filter_.update(clean(obs, np.zeros(len(obs))))
        x = full._state @ obs.T[full._places]
        errors.append(estimate - x)
        truth.append(x)
    m = full.prediction
    rows = np.vstack(
        [m.C[[1, 3]], m.nodes[1], m.C[5]]
    )  # travel, device travel, body velocity, tyre load
    error, true = (
        np.std(rows @ np.array(x)[300:], axis=(0, 2)) for x in (errors, truth)
    )
    assert np.all(error[:3] < [0.01 * true[0], 0.01 * true[1], 0.2 * true[2]])
    assert error[3] < 0.3 * true[3]


def test_stage_cost_is_the_objective():
    """MPC's quadratic form of a plan is the sum of `StageCost` over the predicted steps (and the move weight)."""
    cost = StageCost(tyre_load=0.2, current=0.05)
    free = {"horizon": 6, "moves": (1,) * 6, "terminal": False, "centring": 0.0}
    controller = Mpc(CAR, cost, STEP, MpcSettings(move=0.3, **free))
    m = controller.linear.model
    rng = np.random.default_rng(2)
    scale = np.sqrt(np.diag(m.W)) + 1e-4

    def objective(x, c, moves):
        total = 0.0
        for w in moves:
            c = c + w
            x = m.A @ x + m.B * c
            y = m.C @ x + m.D * c
            total += cost(y[0], y[1], y[5], c) + 0.3 * w * w
        return total

    for _ in range(3):
        x0, present = scale * rng.normal(size=m.n), rng.normal()
        moves = 0.2 * rng.normal(size=6)
        given = np.zeros(controller._linear_term.shape[1])
        given[: m.n + 1] = [*x0, present]
        form = (0.5 * moves @ controller._P + controller._linear_term @ given) @ moves
        direct = objective(x0, present, moves) - objective(x0, present, np.zeros(6))
        assert form == pytest.approx(direct, rel=1e-9)


def test_cost_to_go_makes_a_short_horizon_long():
    """With the regulator's cost-to-go, 3 free moves and the infinite horizon agree exactly."""
    controller = Mpc(
        CAR, None, STEP, MpcSettings(horizon=3, moves=(1, 1, 1), friction="equivalent")
    )
    K, _ = move_regulator(controller.linear.model, controller.weights)
    z = np.append(
        np.random.default_rng(3).normal(size=controller.linear.model.n) * 1e-4, 0.02
    )
    free = -controller._inverse @ (controller._linear_term @ z)
    assert free[0] == pytest.approx(-K @ z, rel=1e-6)


def test_soft_limits_bend_the_plan():
    """A plan that would pass the limit of travel passes it by less once the limit counts."""
    controller = baselines.make("mpc")
    m = controller.linear.model
    x = np.linalg.pinv(m.C[[1, 3]]) @ np.array([0.09, 0.0])  # 9 cm of travel

    def plan():
        return controller._solve(x[:, None], np.zeros(1))[:, 0]

    soft = plan()
    assert "solved" in controller.status.lower()
    controller.reset()
    controller._soft_limits = controller._soft_limits * np.inf
    hard = plan()
    given = np.zeros(controller._linear_term.shape[1])
    given[: m.n] = x

    def travel(moves):
        forced = controller._soft_given @ given + controller._soft_moves @ moves
        return np.abs(forced)[20:].max()

    assert travel(soft) <= travel(hard) + 1e-9
    assert not np.allclose(soft, hard)


@pytest.mark.parametrize(
    "status", ["primal infeasible", "maximum iterations reached", "unsolved"]
)
def test_every_solver_status_has_a_defined_answer(status):
    """Without a plan the current goes to zero at the slew limit; with one its rest is used. Both are counted."""
    controller, fresh = baselines.make("mpc"), baselines.make("mpc")
    rough = np.array([3.0, 0.02, -0.4, 0.01, 0.3, 2.0])
    controller._programs[0] = controller._soft_programs[0] = broken(status)
    # towards no current, 0.5 A a step
    assert controller.act(rough) == pytest.approx(1.5)
    assert controller.fallbacks == 1 and controller.status == status
    fresh.act(rough)
    before = fresh.plan[:, 0]
    fresh._programs[0] = fresh._soft_programs[0] = broken(status)
    rough[5] += before[0]
    command = fresh.act(rough)
    assert fresh.fallbacks == 1
    assert command == pytest.approx(rough[5] + before[1] - before[0], abs=0.2)


def test_osqp_statuses_are_read():
    """Solved and inaccurate are taken, any other word is not, nor is a solution that is not finite."""
    import osqp

    kinds = osqp.SolverStatus.__members__
    qp, info, solution = Osqp(np.eye(2), np.eye(2)), SimpleNamespace(status="word"), SimpleNamespace()  # fmt: skip
    idle = dict.fromkeys(("update_data_vec", "warm_start", "solve"), lambda *_, **__: None)  # fmt: skip
    qp._bare = SimpleNamespace(info=info, solution=solution, **idle)

    def taken(*x):
        solution.x = np.array(x)
        return qp.solve(np.zeros(2), -np.ones(2), np.ones(2), np.zeros(2)).x is not None

    for name, info.status_val in kinds.items():
        assert taken(0.0, 0.0) == name.startswith("OSQP_SOLVED"), name
        assert not taken(np.nan, 0.0)


def test_expected_friction_balances_rate_and_force():
    """The implicit friction: rate and force at the end of the step satisfy v = free + g f and f = level erf(...)."""
    rng = np.random.default_rng(5)
    for _ in range(200):
        free, spread = rng.normal(0, 0.2), 10 ** rng.uniform(-3.5, -0.5)
        g = -(10 ** rng.uniform(-6, -3))
        f, _ = _friction(free, g, 500.0, spread)
        v = free + g * f
        assert f == pytest.approx(
            500.0 * math.erf(v / (math.sqrt(2) * spread)), abs=0.5
        )


def test_one_sweep_solves_a_linear_problem():
    """Without friction and inactive limits, DDP gives the regulator's move in one iteration."""
    settings = FrictionMpcSettings(horizon=10, iterations=1, tyre_load=0.0)
    controller = FrictionMpc(frictionless(), None, STEP, settings)
    K, _ = move_regulator(controller.prediction, controller.weights)
    x = np.random.default_rng(6).normal(size=(controller.prediction.n, 1)) * 1e-5
    moves = np.zeros((1, 10))
    _plan(x, np.array([0.01]), moves, np.zeros((1, 10)), controller._problem, 1)
    assert moves[0, 0] == pytest.approx(-K @ np.append(x[:, 0], 0.01), rel=1e-6)


def test_plan_is_a_local_minimum():
    """At a plan on the real car, no small allowed change of any move costs less."""
    settings = FrictionMpcSettings(iterations=60, horizon=12)
    controller = FrictionMpc(CAR, None, STEP, settings)
    m, problem = controller.prediction, controller._problem
    x = np.linalg.pinv(m.C[[1, 2, 3, 4]]) @ np.array([0.01, 0.15, 0.003, -0.05])
    moves, still = np.zeros((1, 12)), np.zeros((1, 12))
    _plan(x[:, None], np.array([0.3]), moves, still, problem, 60)

    def cost(w):
        path, feedback = _empty_path(problem, 12), _empty_feedback(problem, 12)
        return _roll(x, 0.3, w.copy(), feedback, 0.0, np.zeros(12), problem, path)

    best = cost(moves[0])
    for k in range(12):
        for delta in (0.05, -0.05):
            other = moves[0].copy()
            other[k] += delta
            if abs(other[k]) <= SLEW_LIMIT:
                assert cost(other) > best - 1e-4 * best


@pytest.mark.parametrize("name", ["skyhook", "add", "lqg", "mpc", "mpc-friction"])
def test_act_batch_is_act(name):
    batched, cars = baselines.make(name), 3
    seen, sent = rollout(batched, cars=cars, steps=120)
    for i in range(cars):
        single = baselines.make(name)
        single.reset()
        own = [single.act(obs[i]) for obs in seen]
        assert np.allclose(own, sent[:, i], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "network", "road"),
    [
        *((n, "quarter-car-isd", road) for n in OWN for road in ("H", "paper")),
        *((n, f"{car}-car-isd", "H") for n in SEVERAL for car in ("half", "full")),
    ],
)
def test_limits_hold_on_any_road(name, network, road):
    """|I| <= 5 A and |dI| <= 0.5 A per step, finite, on ISO class H (beyond any real road) and the paper's."""
    controller = baselines.make(name, network)
    options = {"observation": controller.observation, "autoreset_mode": "disabled"}
    env = ISDSuspensionVectorEnv(1, network, road=road, **options)
    obs, _ = env.reset(seed=7)
    controller.reset()
    currents = [
        i for i, signal in enumerate(env.task.measured) if signal.kind == "current"
    ]
    for _ in range(200):
        command = np.atleast_1d(controller.act(obs[0]))
        assert command.shape == (len(currents),) and np.isfinite(command).all()
        assert np.abs(command).max() <= CURRENT_LIMIT
        assert np.abs(command - obs[0, currents]).max() <= SLEW_LIMIT + 1e-6
        obs, _, terminated, *_ = env.step(command[None])
        assert not terminated.any()


@pytest.mark.parametrize(
    ("name", "network"),
    [
        *((n, "quarter-car-isd") for n in MEASURED),
        *(pytest.param(n, "half-car-isd", marks=pytest.mark.slow) for n in SEVERAL),
    ],
)
def test_no_observation_breaks_a_controller(name, network):
    """Noise, nonsense, not-a-number and infinity in; finite currents within the limits out; and it recovers."""
    controller = baselines.make(name, network)
    controller.reset()
    rng = np.random.default_rng(8)
    signals, currents = (
        (6, slice(5, 6)) if network == "quarter-car-isd" else (12, slice(10, 12))
    )
    seen = signals + round(
        200 * getattr(controller, "preview", 0.0)
    )  # and a point of road a control step
    for k in range(60):
        obs = (rng.normal(size=seen) * 10 ** rng.uniform(-2, 6)).astype(np.float32)
        if k % 3 == 0:
            obs[rng.integers(signals)] = rng.choice([np.nan, np.inf, -np.inf])
        command = np.asarray(controller.act(obs))
        assert np.isfinite(command).all() and np.abs(command).max() <= CURRENT_LIMIT
    calm = np.zeros(seen, np.float32)
    for _ in range(
        8000 if signals == 6 else 12000
    ):  # several times the 5 s until a road's level is trusted
        calm[currents] = command = controller.act(calm)
    assert np.abs(command).max() < 0.5


def test_ranking_on_the_papers_road():
    """Paired with the passive car over 80 s: LQG and the friction-aware MPC well below, preview far below."""
    assert cost_change(baselines.make("lqg")) < -0.17
    assert cost_change(baselines.make("mpc-friction")) < -0.17
    assert cost_change(baselines.make("mpc-friction-preview"), cars=2) < -0.40
    assert cost_change(baselines.make("isd-passive")) == pytest.approx(0.03, abs=0.03)


def test_mpc_beats_passive_and_the_toolbox_horizons_do_not():
    assert cost_change(baselines.make("mpc"), cars=2, duration=7.5) < -0.10
    assert cost_change(baselines.make("mpc-paper"), cars=2, duration=7.5) > 0.0


@pytest.mark.parametrize(
    "car",
    [
        "quarter-car-isd",
        "quarter-car-eq8",
        "quarter-car-active",
        pytest.param(
            "quarter-car-semiactive", marks=pytest.mark.slow
        ),  # a kernel of its own is compiled
        "half-car-isd",
        "full-car-isd",
    ],
)
def test_no_baseline_is_worse_than_no_current(car):
    """On every kind of car, but for `mpc-paper`, whose failure is documented."""
    names = (
        OWN if "quarter" in car else [*baselines._AT_EACH_CORNER, *baselines.WHOLE_CAR]
    )
    driven = {"isd-passive", *names} - {"passive", "mpc-paper"}
    found = score(sorted(driven), car, episodes=2, duration=4.0)
    costs = {row["policy"]: row["cost"]["value"] for row in found.policies}
    assert {
        name: costs[name] for name in driven if costs[name] > costs["isd-passive"]
    } == {}


@pytest.mark.parametrize("damping", [0.0, 800.0])
def test_passive_elements_of_the_strut_are_counted_once(damping):
    """The motor gives the force of the law less the force of the damper beside it; the main spring counts for neither."""
    network = Network.load("quarter-car-active").with_parameters(
        {"damper.damping": damping}
    )
    skyhook = baselines.make("skyhook", network)
    acceleration, travel, rate = 0.2, 0.01, 0.3
    current = skyhook._command(
        np.array([[acceleration], [travel], [rate], [travel], [rate], [0.0]])
    )
    assert 400.0 * current == pytest.approx(
        skyhook.force(acceleration, rate) - damping * rate
    )


def test_a_stiffer_oil_spring_changes_no_controller():
    """A spring that is stiff already decays within a step: ten or a thousand times the stiffness is the same car."""
    seen, _ = rollout(baselines.make("lqg"), cars=1, steps=80)
    for name in ("lqg", "mpc-paper", "mpc", "mpc-friction"):
        answers = []
        for factor in (10, 30, 100, 300, 1000):
            controller = baselines.make(
                name, CAR.with_parameters({"oil.stiffness": 709e3 * factor})
            )
            answers.append([controller.act(obs[0]) for obs in seen])
        assert np.std(answers, axis=0).mean() < 0.1, name  # A, of up to 5


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (partial(baselines.make, "nonsense"), "no controller 'nonsense'"),
        (partial(baselines.make, "mpc", horizn=3), "no option 'horizn'"),
        (partial(baselines.make, "mpc", horizon=2), "horizon"),
        (partial(baselines.make, "lqg", model="force-rig"), "is no car"),
        *(
            (partial(baselines.make, n, CAR.with_parameters({"tyre.stiffness": 192e-6})), "no linear-quadratic controller can be computed for network 'quarter-car-isd'")
            for n in ("lqg", "mpc-paper", "mpc", "mpc-friction")
        ),
    ],
)  # fmt: skip
def test_bad_input_is_one_clear_line(call, words):
    refused(words, call)


def test_settings_of_lqg_matter_as_they_say():
    """Without compensation the linear law loses most of its effect to friction."""
    with_it, without = Lqg(CAR), Lqg(CAR, settings=LqgSettings(compensation=0.0))
    assert cost_change(with_it, cars=4) < cost_change(without, cars=4) - 0.04


@pytest.mark.parametrize("name", ["lqg", "mpc", "mpc-friction", "mpc-friction-preview"])
def test_a_controller_travels_to_another_process(name):
    first = baselines.make(name)
    again = pickle.loads(pickle.dumps(first))
    points = 50 if name.endswith("preview") else 0
    rows = np.random.default_rng(0).normal(size=(5, 6 + points)) * 0.01
    for c in (first, again):
        c.reset()
    np.testing.assert_allclose(
        [again.act(r) for r in rows], [first.act(r) for r in rows], atol=1e-3
    )


def test_a_damper_set_by_a_current_gives_the_wanted_force_within_its_limits():
    """Skyhook of a body at rest is 1100 N s/m: -2/3 A between 300 and 2700 N s/m at -2 and 2 A. Beyond the limits the current stays at 2 A."""
    seen = np.array([0.0, 0.01, 0.3, 0.01, 0.3, 0.0])
    controller = baselines.make("skyhook", "quarter-car-semiactive")
    for _ in range(3):
        seen[5] = controller.act(seen)
    assert seen[5] == pytest.approx(-2 / 3, rel=2e-3)
    braking = baselines.make("skyhook", "quarter-car-semiactive", travel=9000.0)
    seen[5] = 0.0
    for _ in range(8):
        seen[5] = braking.act(seen)
    assert seen[5] == 2.0
