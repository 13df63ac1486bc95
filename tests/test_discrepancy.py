"""The diagnosis on small rigs with a hidden effect, made by the independent simulator of `reference`."""

import math
from dataclasses import replace

import builders
import numpy as np
import pytest
from builders import channel, damper, element, named, rms, table
from program import refused
from rigs import families
from rigs.hidden import make_case
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from isd_gym import Network, Table, diagnose, simulate
from isd_gym.diagnosis import Hypothesis, SearchSettings, hypotheses
from isd_gym.diagnosis._estimation import multiple_shooting as shooting
from isd_gym.diagnosis._estimation import noise as weighting
from isd_gym.diagnosis._estimation.gauss_newton import Fitter
from isd_gym.diagnosis._estimation.structure import add, base_structure
from isd_gym.diagnosis._hypotheses.library import pairs
from isd_gym.diagnosis._planning.excitation import Excitation, Rig, make_record
from isd_gym.diagnosis._records.splitting import LEAD_IN, split_records
from isd_gym.diagnosis._selection.criteria import CRITERIA
from isd_gym.diagnosis._selection.held_out import HeldOutEvaluator
from isd_gym.diagnosis._selection.held_out_table import row_of
from isd_gym.diagnosis._selection.law_sets import Search
from isd_gym.diagnosis._simulation.interpolation import splined_input
from isd_gym.diagnosis._simulation.problem import Problem, Record, low_pass, thinned
from isd_gym.diagnosis._workflow import held_from
from isd_gym.physics.elements import TYPES
from isd_gym.records.data import check

approx = pytest.approx


def run(kind, seed, settings=None):
    """Return the diagnosis of a rig of a family (`family.kind`) or of the hidden suite, and its case."""
    with np.errstate(over="ignore"):  # a size that is tried on the way to the right one
        case = families.make_case(kind, seed) if "." in kind else make_case(kind, seed)
    records = [table(x, "record") for x in (case.estimation, case.validation) if x]
    return diagnose(
        records[:1], case.model, validate=records[1:], settings=settings
    ), case


#: rigs on which one rule of the search decides: effects, places and values
RIGS = [
    ("decay.quadratic", 306, {("quadratic_damping", "mass", "ground")}, {}),  # the force is large only while a decay begins
    ("gantry.cubic_load", 308, {("cubic_stiffness", "load", "bridge")}, {}),  # sensors leave the place open: three held-out stretches of four began far off
    ("resonator.softening", 308, {("cubic_stiffness", "mass", "ground")}, {}),  # no simulation stays with what is held out
    ("pair.cubic", 312, {("cubic_stiffness", "left", "ground")}, {}),  # stiffer, in N/m^3, than the class allowed for
    ("decay.drag_and_sine", 313, {("quadratic_damping", "mass", "ground"), ("cubic_stiffness", "mass", "ground")}, {}),  # a curve of friction came before the drag
    ("resonator.cubic", 315, {("cubic_stiffness", "mass", "ground")}, {}),  # a wave of less than a period came nearer, and cannot be named
    ("shaken.play", 315, {("backlash", "mass", "base")}, {}),  # three of forty stretches had lost their way, and a damper in the play's joint was named for them
    ("shaken.play", 305, {("backlash", "mass", "base")}, {"gap": approx(0.0542, rel=0.02)}),  # play in the spring alone, beside a damper
    # plain friction leaves 2 % of the deviation; the fit of the falling curve takes more than ten steps
    ("shaken.stribeck", 305, {("stribeck_friction", "mass", "base")}, {"static_level": approx(88.8, rel=0.1)}),
    ("decay2.none", 315, set(), {}),  # a clean one: the fit of the owner's model had stuck
    # fits of segments hand their state to the whole decay, whose frequency the refit had taken up
    ("coast.cubic_shaft", 1801, {("cubic_stiffness", "rim", "hub")}, {"stiffness": approx(9.454e8, rel=0.02)}),
    # the decay's fit with plain friction begins again where the fit of a rising Stribeck curve ended
    ("decay_friction", 61, {("coulomb_friction", "mass", "ground")}, {}),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed", "answer", "values"), RIGS)
def test_what_is_hidden_is_named(kind, seed, answer, values):
    d, _ = run(kind, seed)
    assert named(d) == {(effect, frozenset(place)) for effect, *place in answer}
    assert {k: d.effects[0].parameters[k].value for k in values} == values
    assert answer or d.verdict in ("no_discrepancy", "parameters_only")


def test_brief_stretches_show_where_a_fit_of_a_slightly_damped_motion_begins():
    def resonator(stiffness):
        parts = {"mass": 1.0, "stiffness": stiffness, "damping": 0.006}
        return builders.oscillator(
            "x displacement mass", uncertainty={"spring.stiffness": 0.1}, **parts
        )

    push = 0.1 * np.convolve(
        np.random.default_rng(0).standard_normal(6000), np.ones(5) / 5, mode="same"
    )
    record = builders.recorded(resonator(1.0), 0.1, {"push": push})
    owner = resonator(1.12)
    problem, structure = Problem(owner, [record], ["fit"]), base_structure(owner)
    fitter = Fitter(
        problem, weighting.white_weights(0.01 * record.measured.std(axis=0))
    )
    lost = fitter.fit(structure, iterations=20)
    there = shooting.fit_segments(problem, structure, structure.start, fitter)
    assert there is not None and shooting.is_lightly_damped(owner)
    found = fitter.fit(structure, there, iterations=20)
    assert found.cost < 1e-3 * lost.cost
    assert found.network.parameters["spring.stiffness"] == pytest.approx(1.0, rel=1e-4)
    assert abs(lost.network.parameters["spring.stiffness"] - 1.0) > 0.01
    assert not shooting.is_lightly_damped(Network.load("quarter-car-isd"))


@pytest.mark.parametrize(
    ("stated", "share"), [({"damper.damping": 1.0}, 1e-4), ({"mass.mass": 1.0}, 1 / 8)]
)
def test_a_damping_of_which_only_the_order_is_known_may_vanish(stated, share):
    (free,) = base_structure(
        builders.oscillator("x displacement mass", uncertainty=stated)
    ).free
    assert free.back(free.low - free.mean) == approx(share)


@pytest.mark.parametrize(("damping", "is_light"), [(0.02, True), (2.0, False)])
def test_gravity_holds_a_pendulum_as_a_spring_does(damping, is_light):
    gravity = builders.element("gravity", "gravity_sine", "bob", "ground", torque=8.4)
    elements = [gravity, damper("bob", "ground", damping)]
    angle = builders.channel("x", "angle", "bob")
    pendulum = builders.model("pendulum", elements, [], [angle], inertias={"bob": 1.0})
    assert shooting.is_lightly_damped(Network.load(pendulum)) == is_light


@pytest.mark.slow
def test_quadratic_drag_is_found_in_a_thrown_body():
    """A body is thrown or dropped; the linear drag of its model has to vanish."""

    def thrown(drag):
        weight = element("weight", "constant_force", "body", "ground", force=1.96)
        known = {"weight.force": 0.01, "drag.damping": 1.0}
        seen = channel("acceleration", "acceleration", "body", noise=0.022)
        return builders.network(
            "thrown",
            [weight, drag],
            [],
            [seen],
            masses={"body": 0.2},
            uncertainty=known,
        )

    true = thrown(element("drag", "quadratic_damping", "body", "ground", damping=0.009))
    rng, runs = np.random.default_rng(1), []
    for speed in (6.0, 6.3, 5.8, 6.5, 0.0, 6.1, 5.9, 0.0):
        n = 170 if speed else 110
        slow, fast = rng.standard_normal((2, n))
        noise = 0.08 * lfilter(np.full(12, 1 / 12), [1.0], slow) + 0.022 * fast
        y = builders.recorded(true, 5e-3, {}, n, [0.0, speed]).measured[:, 0] + noise
        runs.append(Table(5e-3 * np.arange(n), {"acceleration": y}, f"{speed} m/s"))
    d = diagnose(
        runs[:5], thrown(damper("body", "ground", 0.03, "drag")), validate=runs[5:]
    )
    assert named(d) == {("quadratic_damping", frozenset({"body", "ground"}))}


def coloured(rng, columns, samples):
    """Columns of AR(1) noise (samples, columns)."""
    return lfilter([1.0], [1.0, -0.9], rng.standard_normal((samples, columns)), axis=0)


def test_coloured_noise_counts_by_its_independent_share():
    r, least = coloured(np.random.default_rng(0), 1, 40000), np.array([1e-3])
    share = weighting.independent_share([r[:30000], r[30000:]])
    assert share == approx([(1 - 0.9**2) / (1 + 0.9**2)], rel=0.1)
    weighted = replace(weighting.weights_of([r], least), share=share)(r)
    assert np.sum(weighted**2) == approx(share[0] * len(r))
    assert weighting.weights_of([0.0 * r], least).level == approx(least)


def test_what_a_filter_had_to_guess_is_not_compared():
    net = Network.load("force-rig-eq6").without_element("seal")
    step, time = 2e-3, np.arange(0.0, 4.0, 2e-3)
    x = 0.01 * np.sin(12.0 * time)  # begins and ends in mid-motion
    v, a = 0.12 * np.cos(12.0 * time), -1.44 * np.sin(12.0 * time)
    name = net.inputs[0].name
    taps = np.hanning(101) / np.hanning(101).sum()
    force = 95.0 * a + 1293.0 * v + 709e3 * x
    seen = low_pass(force[:, None], taps)[100:-100:5]
    record = Record(
        "rig", step, {name: x}, seen, {name: (v, a)}, taps=taps, thin=5, margin=20
    )
    problem = Problem(net, [record, record.part(50, 200, "rig")], ["fit", "fit"])
    y, part = (problem.simulate([net], i, None)[:, 0, 0] for i in (0, 1))
    assert len(y) == len(seen)
    np.testing.assert_allclose(part, y[50:200], atol=1e-9 * np.abs(y).max())
    np.testing.assert_allclose(y, seen[:, 0], atol=2e-3 * np.abs(seen).max())


def test_a_stribeck_curve_takes_the_place_of_the_friction_found_before():
    rig = Network.load("force-rig-eq6").without_element("seal")
    where = (rig.moved_nodes[0], "ground")
    white_filters = add(
        base_structure(rig), Hypothesis("coulomb_friction", where), {"level": 300.0}
    )
    curve = {"level": 300.0, "static_level": 500.0, "stribeck_velocity": 0.1}
    both = add(white_filters, Hypothesis("stribeck_friction", where), curve)
    assert [h.effect for h in both.hypotheses] == ["stribeck_friction"]
    assert [both.network.element(name).type for name in both.names] == [
        "stribeck_friction"
    ]


def test_the_later_part_of_a_record_begins_where_the_fit_to_its_beginning_ends():
    # friction gives the piston many rests: from a guess the first stretch held out ended in another (0.063 of the deviation)
    drag = element("drag", "quadratic_damping", "piston", "ground", damping=1381.0)
    net = Network.load("force-rig").with_element(drag)
    band = (3.437331794985563, 20.623990769913377)
    rig = Rig({"displacement": (0.01, 0.5)}, band, 20.0, 0.002424361053969285)
    record = make_record(net, rig, Excitation("multisine", band, ("displacement",)))
    clean = simulate(net, record.time, record.inputs)["force"]
    noisy = clean + 16.0 * np.random.default_rng(1).standard_normal(len(clean))
    whole = Problem(net, [replace(record, measured=noisy[:, None])], ["fit"])
    problem = Problem(net, *split_records(whole.records, [], [], whole.time))
    evaluator, structure = HeldOutEvaluator(problem), base_structure(net)
    fit = evaluator.plain_fitter.fit(structure, structure.start, iterations=0)
    assert row_of(evaluator, fit).error < 0.02  # 0.011 of it noise


def test_a_superfluous_law_is_left_out_from_the_values_of_a_set():
    # a stop that a fit alone did not find, beside a cubic spring that there is not
    stop = element("stop", "bump_stop", "mass", "ground", clearance=0.01, stiffness=4e4)
    model = builders.oscillator("x displacement mass")
    time = np.arange(0.0, 6.0, 0.005)
    push = builders.sines(time, [1.1, 2.3, 3.7], [0.0, 1.0, 2.0], 40.0)
    record = builders.recorded(model.with_element(stop), 0.005, {"push": push})
    problem = Problem(model, [record, record], ["fit", "choose"])
    where, structure = ("mass", "ground"), base_structure(model)
    laws = {
        "bump_stop": {"clearance": 0.01, "stiffness": 4e4},
        "cubic_stiffness": {"stiffness": 1.0},
    }
    for effect, values in laws.items():
        structure = add(structure, Hypothesis(effect, where), values)
    evaluator = HeldOutEvaluator(problem)
    both = evaluator.plain_fitter.fit(structure, iterations=0)
    search = Search(evaluator, SearchSettings(), CRITERIA, print)
    fewer = {fit.label: fit for fit in search._with_fewer(both)}
    assert set(fewer) == {f"{effect} at mass-ground" for effect in laws}
    alone = fewer["bump_stop at mass-ground"]
    assert alone.elements[0].clearance == approx(0.01, rel=0.01)
    errors = [rms(record.measured - fit.outputs[0]) for fit in fewer.values()]
    assert min(errors) < 0.02 * max(errors)


def test_play_may_be_in_line_with_one_of_the_elements_that_stand_side_by_side():
    # a spring with play beside a damper without play: both elements used to stand behind the play
    net = Network.load(families.make_case("shaken.play", 305).model)
    k, c, m = (
        net.parameters[p] for p in ("spring.stiffness", "damper.damping", "mass.mass")
    )
    series = {h.label: h for h in hypotheses(net) if h.kind.series}
    assert (
        set(series)
        == {
            "series_compliance at mass-base",
            "series_compliance at mass-base (of damper)",  # of the spring it would be a softer spring
            "backlash at mass-base",
            "backlash at mass-base (of spring)",
            "backlash at mass-base (of damper)",
        }
    )
    gap = 0.02
    faces = {"gap": gap, "stiffness": 1e4 * k}
    built = add(base_structure(net), series["backlash at mass-base (of spring)"], faces)
    time = np.arange(0.0, 3.0, 0.002)
    base = 0.05 * np.sin(2.0 * math.pi * time)
    name = net.moving[0].name
    seen = simulate(built.network, time, {name: base})["mass_displacement"]

    def rate(t, y):
        d = y[0] - 0.05 * math.sin(2.0 * math.pi * t)
        v = y[1] - 0.1 * math.pi * math.cos(2.0 * math.pi * t)
        # the play's own faces give by a ten-thousandth
        spring = k * math.copysign(max(abs(d) - 0.5 * gap, 0.0), d)
        return [y[1], -(spring + c * v) / m]

    exact = solve_ivp(
        rate, (0.0, 3.0), [0.0, 0.0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.002
    ).y[0]
    assert np.std(seen - exact) < 0.01 * np.std(exact)


def test_what_acts_through_a_moved_nodes_acceleration_is_seen_between_samples():
    # along lines every sample of the base was a knock: an inertance came out with twice the acceleration, and a compliance beside it
    parts = {"beside": [element("b", "inertance", "mass", "base", inertance=6.0)]}
    net = builders.oscillator(
        "a acceleration mass", base="base", mass=20.0, damping=40.0, **parts
    )
    time = np.arange(
        0.0, 25.0, 0.016
    )  # what it began with has died out by the thousandth sample
    w = 2.0 * math.pi * 4.5
    base = 1e-4 * np.sin(w * time)
    for every, bound in ((4, 0.05), (16, 0.03)):
        record = Record("r", 0.016, {"base": base}, np.zeros((len(time), 1)))
        problem = Problem(net, [record], ["fit"], step=0.16 / every, time=0.1)
        assert problem.every(record) == every
        seen = problem.simulate([net], 0)[1000:, 0, 0]
        gain = (2000.0 - 6.0 * w**2 + 40.0j * w) / (2000.0 - 26.0 * w**2 + 40.0j * w)
        exact = 1e-4 * (-(w**2) * gain * np.exp(1j * w * time)).imag[1000:]
        assert np.std(seen - exact) < bound * np.std(exact), every


def test_noise_of_a_moved_node_does_not_rule_its_acceleration():
    # of a spline's second derivative it did: a dyno's inertance, 10.7 to 1.4 % of the force, was refused
    rng = np.random.default_rng(0)
    for step, samples, noise, most in (
        (1e-3, 4000, 1e-6, 0.7),
        (0.05, 400, 0.0, 0.0),
        (0.05, 400, 1e-6, 6.5),
    ):
        time = step * np.arange(samples)
        x = 0.01 * np.sin(2.0 * math.pi * time)
        for every in (1, 4):
            noisy = x + noise * rng.standard_normal(samples)
            seen = splined_input(noisy, None, step, every, sparse=False)[2][::every]
            wrong = (seen + (2.0 * math.pi) ** 2 * x)[5:-5]  # a spline's ends are free
            allowed = most * noise / step**2 + 0.01 * 0.01 * (2.0 * math.pi) ** 2
            assert rms(wrong) < allowed, (step, noise, every)


def test_a_rig_that_moves_by_micrometres_may_have_a_stiff_cubic():
    for stiffness in (4.4e15, -1e20):
        TYPES["cubic_stiffness"](
            name="x", where=("mass", "ground"), stiffness=stiffness
        )
    refused(
        "stiffness",
        TYPES["cubic_stiffness"],
        name="x",
        where=("mass", "ground"),
        stiffness=1e30,
    )


def test_noise_comes_from_the_measured_signal_and_not_from_the_misfit():
    rng = np.random.default_rng(4)
    step, n = 4e-3, 8000
    t = step * np.arange(n)
    motion = np.sin(2 * np.pi * 1.1 * t) + 0.3 * np.sin(2 * np.pi * 3.7 * t)
    found = weighting.floor_of([motion + 0.02 * rng.standard_normal(n)], step)
    assert found.known and found.deviation == pytest.approx(0.02, rel=0.1)
    # the misfit of a bad model would be as large as the motion
    assert found.deviation < 0.05 * motion.std()


def test_the_owner_says_what_the_noise_of_an_output_is():
    model = Network.load("force-rig").to_dict()
    model["outputs"][0]["noise"] = 12.5
    net = Network.load(model)
    assert Network.load(net.to_dict()) == net
    t = 2e-3 * np.arange(2000)
    x = 0.01 * np.sin(12.0 * t)
    record = Record(
        "rig", 2e-3, {net.inputs[0].name: x}, 500.0 * np.sign(np.cos(12.0 * t))[:, None]
    )
    evaluator = HeldOutEvaluator(Problem(net, [record, record], ["fit", "choose"]))
    noise = evaluator.noise_estimates[0]
    assert noise.source == "owner" and noise.deviation == 12.5
    model["outputs"][0]["noise"] = -1.0
    refused("noise", Network.load, model)


def test_every_mass_and_the_ground_is_a_place_whatever_is_moved():
    car = Network.load("quarter-car-isd")
    assert {("body", "ground"), ("wheel", "ground")} <= set(pairs(car))
    tried = {(h.effect, h.where) for h in hypotheses(car)}
    assert ("coulomb_friction", ("body", "ground")) in tried
    assert ("inertance", ("body", "ground")) not in tried  # the mass may move already


def test_three_sets_of_records_and_one_record_cut_where_its_motion_is():
    t = 1e-2 * np.arange(3000)
    drive = Record("drive", 1e-2, {"u": t}, np.sin(6.0 * t)[:, None])
    notes = []
    records, roles = split_records([drive], [drive], notes, drive.pace)
    assert roles[0] == "fit" and {"choose", "report"} <= set(roles)
    fitted = roles.count("fit")
    assert sum(len(r) for r in records[:fitted]) == len(drive)
    assert sum(len(r) for r in records[fitted:]) == len(drive)
    # a decay: two thirds of its motion are over long before two thirds of its time
    decay = Record("decay", 1e-2, {}, (np.exp(-0.4 * t) * np.cos(6.0 * t))[:, None])
    records, roles = split_records([decay], [], notes, decay.pace)
    assert roles[0] == "fit" and len(records[0]) < 0.4 * len(decay)
    assert any("only record" in n for n in notes)
    # a steep one: what is held out has a third of its way, and not the noise at its end alone
    steep = Record("steep", 1e-2, {}, (7.0 / (1.0 + 2.0 * t))[:, None])
    records, _ = split_records([steep], [], notes, steep.pace)
    assert len(records[0]) < 0.15 * len(steep) < 0.15 * 1.01 * sum(map(len, records))
    # at rest after a third: noise is no motion, and most of the rest is left out
    still = np.where(t < 10.0, decay.measured[:, 0], 0.0)
    still += 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    rested = Record("rested", 1e-2, {}, still[:, None])
    records, roles = split_records([rested], [], notes, rested.pace)
    assert len(records[0]) < 0.2 * len(rested)
    assert sum(map(len, records)) < 0.5 * len(rested)
    assert "nothing moves" in notes[-2]
    # friction stops a wheel after a tenth of the record: the pace is the rest's
    rng = np.random.default_rng(0)
    speed = np.maximum(1.0 - t[:800] / 0.8, 0.0) + 3e-3 * rng.standard_normal(800)
    stopped = Record("stopped", 1e-2, {}, speed[:, None])
    (first, rest), _ = split_records([stopped], [], notes, stopped.pace)
    assert len(first) < 70 and len(rest) < 300 and np.ptp(rest.measured) > 0.1
    # a slow decay has no rest
    slow = Record("slow", 1e-2, {}, (np.exp(-0.03 * t) * np.cos(6.0 * t))[:, None])
    assert sum(map(len, split_records([slow], [], notes, slow.pace)[0])) == len(slow)


def test_what_each_whole_record_was_for_is_what_was_fitted_and_held_out():
    net = Network.load("quarter-car-passive")
    t = 0.005 * np.arange(3000)
    inputs = {c.name: 0.01 * np.sin(9 * t) for c in net.inputs}
    measured = np.stack([np.sin(9 * t)] * len(net.outputs), axis=1)
    runs = [Record(name, 0.005, inputs, measured.copy()) for name in ("a", "b", "a")]
    inf = math.inf

    def since(fit, held):
        records, roles = split_records(fit, held, [], 0.1)
        whole = Problem(net, [*fit, *held], ["fit"] * len(fit) + ["report"] * len(held))
        return held_from(whole, Problem(net, records, roles))

    assert since(runs, []) == (inf, inf, -inf)  # the last third of the records
    assert since(runs[:1], runs[1:]) == (inf, -inf, -inf)
    (cut,) = since(runs[:1], [])  # the last third of the only record
    assert cut == pytest.approx(10.0, abs=1.0)
    records, roles = split_records(runs[:1], [], [], 0.1)
    last = records[roles.count("fit") - 1]
    assert last.time[-1] == pytest.approx(cut - 0.005)


def test_a_knock_and_then_rest_leaves_enough_to_fit_and_to_judge_by():
    counts = np.zeros(3000)  # an encoder's, which does not flicker
    counts[:4] = [9, -9, 9, -9]
    knock = Record("knock", 1e-2, {}, counts[:, None])
    records, roles = split_records([knock], [], [], knock.pace)
    assert roles[0] == "fit" and min(map(len, records)) >= 32


@pytest.mark.parametrize("thin", [1, 2])
def test_a_stretch_of_a_prescribed_motion_remembers_what_came_before_it(thin):
    model = Network.load("force-rig")
    moved, first = (
        model.inputs[0].name,
        model.outputs[0].between or (model.outputs[0].at, "ground"),
    )
    net = model.with_element(
        element("rubs", "hysteresis", *[*first], level=300.0, stiffness=1e6)
    )
    t = 2e-3 * np.arange(6000)
    x = 0.01 * np.sin(9.0 * t)
    still = Record("drive", 2e-3, {moved: x}, np.zeros((len(t), 1)))
    said = Problem(net, [still], ["fit"]).simulate([net], 0)[:, :, 0]
    drive = Record("drive", 2e-3, {moved: x}, said).part(
        1200, len(t), "drive"
    )  # begins in mid-loop
    off = []
    for lead in (0.0, LEAD_IN * drive.pace):
        pieces, roles = split_records([drive], [drive], [], 0.1 * drive.pace, lead)
        pieces = [thinned(r, thin, ()) for r in pieces] if thin > 1 else pieces
        problem = Problem(net, pieces, roles)
        errors = [
            problem.simulate([net], i)[:, :, 0] - r.measured
            for i, r in enumerate(pieces)
        ]
        off.append(max(rms(e[: len(e) // 2]) for e in errors))
        np.testing.assert_allclose(
            pieces[-1].time, t[-len(pieces[-1]) * thin :: thin][: len(pieces[-1])]
        )
    assert off[0] > 50.0 and off[1] < (
        1.0 if thin == 1 else 3.0
    )  # N; a thinner one is another step's


def test_what_rests_again_and_again_and_goes_on_from_there_is_not_frozen():
    rng = np.random.default_rng(6)
    t = 2e-3 * np.arange(4000)
    wave = np.sin(3.0 * t) + 0.3 * np.sin(11.0 * t)
    going = np.ones(len(t), bool)
    for begin in range(100, 3900, 130):
        going[begin : begin + 25] = False
    rough = np.diff(wave, prepend=wave[0]) + 2e-3 * rng.standard_normal(len(t))
    stuck = Table(t, {"x": np.cumsum(np.where(going, rough, 0.0))}, "rig")
    found = check(stuck, inputs={}, outputs={"x": "displacement"})
    assert ("error", "held") not in {(f.level, f.check) for f in found}
