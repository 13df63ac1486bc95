"""Reports: what they draw is what happened, the pages stand alone, and no folder is left half written."""

import base64
import hashlib
import html
import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import matplotlib
import matplotlib.figure
import numpy as np
import pytest
from builders import rms, sines
from html_page import Page
from program import printed, read_json, refused, run
from test_criteria import NONE

from isd_gym import Diagnosis, Network, score, simulate
from isd_gym.benchmark.policies import find, passive
from isd_gym.diagnosis import (
    CRITERIA,
    Effect,
    Evidence,
    Gate,
    LawSet,
    Place,
    Quantity,
    Trace,
)
from isd_gym.diagnosis._verdict.gates import gates_of
from isd_gym.diagnosis.result import BestCandidate, ScreenedPlace
from isd_gym.physics.elements import TYPES, CoulombFriction
from isd_gym.records import schemas
from isd_gym.view.report import charts, plots, steps
from isd_gym.view.report import diagnosis as report
from isd_gym.view.report import score as score_page

jsonschema = pytest.importorskip("jsonschema")

LEVEL = 150.0
STEP = 4e-3


def road(n, seed):
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(n)
    f = rng.uniform(0.5, 12.0, 25)
    return sines(t, f, rng.uniform(0, 6.28, 25), 0.012 / f) * np.minimum(t, 1)


def errors_of(trace):
    """Errors by stage and channel, relative to the deviation, with the floor of the noise."""
    deviation = {c: np.std(y) for c, y in trace.measured.items()}
    gap = {"noise_floor": dict.fromkeys(deviation, 0.02)}
    for stage in ("before", "refit", "after"):
        says = getattr(trace, stage)
        gap[stage] = {
            c: float(np.std(trace.measured[c] - says[c]) / s)
            for c, s in deviation.items()
        }
    return gap


def law_set(effect, excess, model, **values):
    """Return a set of one law at the piston."""
    place, file = ("piston", "joint"), f"set_{effect}.json"
    return LawSet((effect,), (place,), (values,), ({},), excess, 0.4, 0.1, file, model)


def made_diagnosis():
    """A car that lacks its seal friction, and the friction found: records from the true car, with 2 % noise."""
    true = Network.load("quarter-car-isd")
    kept = [e for e in true.elements if e.type not in ("coulomb_friction", "bump_stop")]
    base = replace(
        true,
        elements=tuple(kept),
        uncertainty={"body.mass": 0.05, "oil.stiffness": 0.05},
    )
    model = base.with_element(CoulombFriction("seal", ("piston", "joint"), level=LEVEL))
    model = replace(
        model, uncertainty={"seal.level": 0.02}
    )  # standard deviation of the fit
    rng = np.random.default_rng(1)
    traces = []
    for name, held in (("one", False), ("two", True)):
        n = 2500
        t = STEP * np.arange(n)
        inputs = {"road": road(n, held), "current": np.zeros(n)}
        old, new = (simulate(net, t, inputs) for net in (base, model))
        measured = {
            c: y + 0.02 * y.std() * rng.standard_normal(n) for c, y in new.items()
        }
        traces.append(Trace(name, held, t, inputs, measured, old, old, new))
    last = traces[-1]
    gap = errors_of(last)
    level = Quantity(LEVEL, 145.2, 154.9, "N")
    return Diagnosis(
        verdict="missing_effect",
        summary="The model lacks coulomb friction between piston and joint (level 150 N).",
        effects=(Effect("coulomb_friction", ("piston", "joint"), None, 0.993, {"level": level}, "seal"),),
        sets=(
            law_set("coulomb_friction", 0.01, model, level=LEVEL),
            law_set("hysteresis", 0.31, model, level=LEVEL, stiffness=1e6),
        ),
        where=(Place("suspension_travel", 0.7, (0.8, 2.0)),),
        places=(
            ScreenedPlace(("piston", "joint"), "coulomb_friction", 0.81),
            ScreenedPlace(("body", "wheel"), "viscous_damping", 0.12),
            ScreenedPlace(("suspension_travel",), "sensor_gain", 0.0),
        ),
        parameters={"body.mass": Quantity(351.2, 349.9, 352.4, "kg", 345.0)},
        gap=gap,
        closed=0.99,
        gates=(Gate("significant", True, 6812.0, 60.0, "twice the log likelihood gained"),),
        next_experiment=None, base=base, refitted=base, model=model,
        traces=tuple(traces),
        notes=("held out: two",), seconds=12.3,
        units={c.name: c.unit for c in base.outputs},
        criteria=CRITERIA,
        evidence=evidence_of(gap, explained=0.99),
    )  # fmt: skip


def evidence_of(gap, explained):
    channels = tuple(gap["refit"])
    rows = {k: tuple(gap[k].values()) for k in ("before", "refit", "after")}
    return Evidence(
        channels, **rows, noise=tuple(gap["noise_floor"].values()), noise_known=(True,) * len(channels),
        training_refit=rows["refit"], explained=explained,
    )  # fmt: skip


CURVES = ["steps", "loops", "gap", "time"]
FIGURES = [*CURVES, "spectra", "law", "parameters"]
#: of friction that leaves nearly all
GATES = gates_of(NONE)
KINDS = ("missing_effect", "no_discrepancy", "parameters_only", "unknown_effect")


def of_kind(d, kind):
    """The result of another verdict, over the records of `d`, whose model lacks the friction of a seal."""
    if kind == "missing_effect":
        return d
    traces = [replace(t, after=t.refit) for t in d.traces]
    if kind in ("no_discrepancy", "parameters_only"):  # the simulation agrees
        traces = [replace(t, before=t.after, refit=t.after) for t in d.traces]
    gap = errors_of(traces[-1])
    evidence = evidence_of(gap, explained=0.42)
    best = BestCandidate(
        ("hysteresis",), (("piston", "joint"),), ({"level": 120.0, "stiffness": 1e6},), 0.42, gap, tuple(g for g in GATES if not g.passed)
    )  # fmt: skip
    made = replace(
        d, verdict=kind, summary=f"So: {kind}.", effects=(), sets=(), closed=None,
        gates=GATES, evidence=evidence, best_candidate=best, gap=gap, model=d.base, traces=tuple(traces),
    )  # fmt: skip
    if kind in ("no_discrepancy", "parameters_only"):
        own = replace(
            made, base=d.model, refitted=d.model, model=d.model, where=(), gates=()
        )
        return replace(own, best_candidate=None)
    return made


def reopened(d, page):
    """Open every file of a written report again and check it against the result; return the page."""
    folder = page.parent

    def no_constant(text):
        raise AssertionError(f"{text} in diagnosis.json")

    said = json.loads(
        (folder / "diagnosis.json").read_text(), parse_constant=no_constant
    )
    jsonschema.validate(said, schemas.load("isd-diagnosis/1"))
    assert said["verdict"] == d.verdict and said["summary"] == d.summary
    model = Network.load(folder / "model.json")
    trace = d.traces[-1]
    for channel, y in simulate(model, trace.time, trace.inputs).items():
        assert y == pytest.approx(trace.after[channel], rel=1e-6, abs=1e-6 * np.ptp(y))
    for file in folder.glob("*.svg"):
        assert len(ElementTree.parse(file).findall(".//{*}path")) > 10, (
            f"{file.name} is blank"
        )
    names = {p.name for p in folder.iterdir() if p.suffix != ".svg"}
    assert names == {"report.html", "diagnosis.json", "model.json"}
    shown = check_page(page)
    assert not re.search(r"\b(inf|nan|None)\b", shown.text)
    return shown


@pytest.fixture(scope="module")
def diagnosis():
    return made_diagnosis()


@pytest.fixture(scope="module")
def written(diagnosis, tmp_path_factory):
    """The page of the diagnosis, all figures of which take seconds."""
    folder = tmp_path_factory.mktemp("report") / "found"
    return report.write_report(diagnosis, folder, about={"Model": "rig & co.json"})


@pytest.fixture(scope="module")
def small_score():
    car = Network.load("quarter-car-isd")
    entries = [find(n, car) for n in ("passive", "isd-passive", "skyhook")]
    return score(entries, car, reference=passive(car), episodes=3, duration=4.0)


@pytest.fixture(autouse=True)
def no_bound(monkeypatch):
    """The causal bound takes seconds and is tested beside the baselines."""
    monkeypatch.setattr("isd_gym.benchmark.ceilings.fronts", lambda score: [])


@pytest.fixture
def quick(monkeypatch):
    """One figure is enough where folders are looked at."""
    monkeypatch.setattr(report, "FIGURES", report.FIGURES[:1])


def check_page(path):
    """Check that a page needs no other file: nothing is fetched, every script is named, every picture has a description."""
    page = Page(path)
    assert page.links == [] and "link" not in page.tags
    assert (
        not re.search(r"url\((?!#)", path.read_text())
        and "@import" not in path.read_text()
    )
    assert path.stat().st_size < 3_000_000
    (policy,) = page.policies
    allowed = re.search(r"script-src (.*)", policy)[1].split()
    assert policy.startswith("default-src 'none'; img-src data:")
    assert "'unsafe" not in policy.split("script-src")[1]
    digests = (
        base64.b64encode(hashlib.sha256(s.encode()).digest()) for s in page.scripts
    )
    assert [f"'sha256-{d.decode()}'" for d in digests] == allowed
    assert page.charts and all(
        chart["role"] == "img" and chart["aria-label"] for chart in page.charts
    )
    assert set(page.figures) == {file.stem for file in path.parent.glob("*.svg")}
    return page


def test_the_missing_force_is_the_friction_that_the_model_lacks(diagnosis):
    """Residuals alone give the level of the friction, and the sign by the rate."""
    missing = report.View(diagnosis).missing
    assert missing.pair == ("piston", "joint")
    rate, force = missing.curve.rate, missing.curve.force
    moving = np.abs(rate) > 0.02
    along = force[moving] * np.sign(rate[moving])
    assert moving.mean() > 0.2
    assert np.mean(along) == pytest.approx(LEVEL, rel=0.15)
    assert np.corrcoef(force[moving], np.sign(rate[moving]))[0, 1] > 0.85
    # the rate is that of the record
    measured = np.gradient(
        simulate(diagnosis.model, *_held(diagnosis))["device_travel"], STEP
    )[125:-125]
    assert rms(rate - measured) < 0.05 * measured.std()


def test_the_first_figure_has_the_places_the_force_and_the_laws(diagnosis):
    """The curve of a law is the missing force where the law is true, and another where it is not."""
    cubic = law_set("cubic_stiffness", 0.9, diagnosis.model, stiffness=1e6)
    sets = (diagnosis.sets[0], cubic)
    chart = steps.draw_steps(report.View(replace(diagnosis, sets=sets)))
    places, force, laws = chart.panels
    assert places.y.rows == ("piston – joint", "body – wheel", "suspension travel")
    blue, grey = (i for i in places.items if isinstance(i, charts.Marks))
    assert list(blue.x) == pytest.approx([81.0]) and list(grey.x) == pytest.approx(
        [12.0, 0.0]
    )
    (median,) = (i for i in force.items if isinstance(i, charts.Line))
    assert np.all(median.band[0] <= median.y) and np.all(median.y <= median.band[1])
    again, true, false = (i for i in laws.items if isinstance(i, charts.Line))
    assert again.y is median.y and true.name.startswith("Coulomb friction")
    shares = [int(re.search(r"\((\d+)", line.name)[1]) for line in (true, false)]
    assert (
        shares[0] > 80 > shares[1] + 10
    )  # mass, spring and damper take a part of either
    fast = np.abs(median.x) > 0.05
    # on average over the bins: those at the ends have few samples
    away, far = (np.abs(line.y - median.y)[fast].mean() for line in (true, false))
    assert away < 0.2 * LEVEL and away < 0.5 * far


def test_without_a_search_the_gap_comes_first(diagnosis):
    view = report.View(replace(diagnosis, places=()))
    assert view.first == "gap" and steps.draw_steps(view) is None


def _held(d):
    return d.traces[-1].time, d.traces[-1].inputs


def test_report_stands_alone_and_says_it_all(written):
    path = written
    page = check_page(path)
    names = {p.name for p in path.parent.iterdir()}
    pictures = {f"{n}.svg" for n in FIGURES}
    files = {"report.html", "diagnosis.json", "model.json", "set_hysteresis.json"}
    assert names == files | pictures
    assert re.search(r'id="figure-(\w+)"', path.read_text())[1] == "steps"
    for words in (
        "Missing: Coulomb friction between piston and joint", "error in device travel on held-out data falls", "145.2 to 154.9", "hysteresis between piston and joint",
        "set_hysteresis.json", "significant", "jump by twice 150.0\u00a0N", "held out: two", "rig & co.json",
        "351.2\u00a0kg", "confirm it with a new record", "Coulomb friction",
    ):  # fmt: skip
        assert words in page.text, words
    assert read_json(path.parent / "diagnosis.json")["verdict"] == "missing_effect"
    assert Network.load(path.parent / "model.json").element("seal").level == LEVEL


def test_parameters_are_marked_as_biased_where_nothing_is_named(diagnosis):
    for kind in KINDS:
        view = report.View(of_kind(diagnosis, kind))
        is_undecided = kind.startswith("unknown")
        assert (
            "biased by what is missing" in report._html(view, {}, {})
        ) == is_undecided


def test_a_diagnosis_is_short_in_a_prompt_and_a_table_in_a_notebook(diagnosis):
    told = "'missing_effect', found=['coulomb_friction piston-joint'], closed=0.99, 2 record(s)"
    assert repr(diagnosis) == f"Diagnosis({told})"
    for kind in KINDS:
        d = of_kind(diagnosis, kind)
        assert len(repr(d)) < 200 and repr(d).startswith(f"Diagnosis('{d.verdict}'")
        text = d._repr_html_()
        assert (
            d.summary in html.unescape(text)
            and text.count("<table>") == text.count("</table>") > 0
        )
        assert f"{100 * d.gap['refit']['suspension_travel']:.1f} %" in text
        assert ("145.2 to 154.9" in text) == (kind == "missing_effect")
    assert "<b>x</b>" not in replace(diagnosis, summary="<b>x</b>")._repr_html_()


def test_a_sensor_is_told_from_physics(diagnosis, tmp_path, quick):
    gain = {"gain": Quantity(1.127, 1.125, 1.129, "-")}
    effect = Effect("sensor_gain", None, "body_acceleration", 0.99, gain, "g")
    check_page(
        report.write_report(replace(diagnosis, traces=()), tmp_path / "x")
    )  # without records
    page = check_page(
        report.write_report(replace(diagnosis, effects=(effect,)), tmp_path / "x")
    )
    assert (
        "A sensor has a fault" in page.text
        and "Sensor gain in body acceleration" in page.text
    )
    assert "it must read 1.1270 times the truth" in page.text


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("series_compliance", {"stiffness": 5e4}),
        ("backlash", {"gap": 0.002, "stiffness": 5e6}),
    ],
)
def test_the_law_of_a_series_effect_is_drawn_over_its_own_elongation(
    diagnosis, kind, more
):
    """Its terminals are no pair of the old model."""
    own = diagnosis.model.to_dict()
    next(e for e in own["elements"] if e["name"] == "damper")["between"] = [
        "play",
        "wheel",
    ]
    own["elements"].append(
        {"name": "own", "type": kind, "between": ["joint", "play"], **more}
    )
    own["uncertainty"] = {}
    model = Network.load(own)
    shown = next(iter(more))
    q = Quantity(more[shown], 0.9 * more[shown], 1.1 * more[shown], "")
    effect = Effect(kind, ("joint", "wheel"), None, 0.99, {shown: q}, "own")
    view = report.View(replace(diagnosis, model=model, effects=(effect,)))
    (law,) = view.laws
    d = law.axis[-1]
    force = 5e4 * d if kind == "series_compliance" else 5e6 * (d - 0.001)
    assert law.force[-1] == pytest.approx(force) and law.force[0] == pytest.approx(
        -force
    )
    wide = 0.1 * 5e4 * d if kind == "series_compliance" else 0.05 * 5e6 * 0.002
    assert law.high[-1] - law.force[-1] == pytest.approx(wide, rel=1e-6)
    assert np.abs(law.visited).max() >= 0.99 * d > 0
    assert "in series with what stands between joint and wheel" in report._html(
        view, {}, {}
    )
    chart = report.draw_law(view)
    assert chart is not None and "its own travel" in chart.panels[0].x.text


def test_two_effects_are_told_as_two(diagnosis):
    view = report.View(replace(diagnosis, effects=2 * diagnosis.effects))
    assert (
        view.title == "Two physical effects are missing"
        and view.labels["after"] == "with the effects"
    )


def test_only_units_of_a_sentence_are_set_as_units(diagnosis):
    view = report.View(diagnosis)
    says = "The model lacks {} between degree and rod (slope 0.5 N m s/rad, pitch 2 deg); 3 degressive laws at 0.1 deg/s."
    shown = "The model lacks {} between degree and rod (slope 0.5 N·m·s/rad, pitch 2 °); 3 degressive laws at 0.1 °/s."
    for effect in TYPES:
        name = effect.replace("_", " ")
        assert view.printed(says.format(name)) == shown.format(name)


def test_what_is_no_folder_is_refused(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    refused("not a folder", report.check_target, tmp_path / "file")
    monkeypatch.chdir(tmp_path)
    refused("a folder of its own", report.check_target, ".")
    (tmp_path / "empty").mkdir()
    report.check_target("empty")


def test_score_report_stands_alone(small_score, tmp_path):
    before = dict(matplotlib.rcParams)
    path = score_page.score_report(small_score, tmp_path / "score")
    assert dict(matplotlib.rcParams) == before
    page = check_page(path)
    names = {"trade_off", "histories", "spectra"}
    assert {p.stem for p in path.parent.glob("*.svg")} == names
    told = json.loads(json.dumps(small_score.to_dict()))
    assert read_json(path.parent / "score.json") == told
    row = next(r for r in small_score.policies if r["policy"] == "skyhook")
    assert f"{row['cost']['value']:.3f}" in page.text
    assert plots.percent(row["tyre_load_rms"]["change"]) in page.text
    assert score_page.Shown(small_score).headline in page.text
    refused(r"no earlier diagnosis", report.check_target, path.parent)


def test_the_page_of_a_half_car_shows_both_axles(tmp_path):
    car = Network.load("half-car-isd")
    made = score(["lqg", "lqg-wheelbase"], car, episodes=2, duration=2.0)
    page = check_page(score_page.score_report(made, tmp_path / "half"))
    for words in ("pitch acc.", "RMS, front, mm", "RMS, rear, N", "RMS, m/s², driver"):
        assert words in page.text
    chart = score_page.histories(score_page.Shown(made))
    heads = [panel.y.label.replace("\n", " ") for panel in chart.panels]
    ends = ("front travel", "rear travel", "front motor current", "rear motor current")
    assert tuple(h for h in heads if "travel" in h or "current" in h) == ends
    run = made.runs["lqg-wheelbase"]
    rear = next(
        p for p in chart.panels if p.y.label.replace("\n", " ") == "rear travel"
    )
    line = next(i for i in rear.items if getattr(i, "name", "") == "lqg-wheelbase")
    assert (
        np.abs(line.y).max()
        <= 1e3 * np.abs(run.signals["suspension_travel_rear"]).max() + 1e-9
    )


def test_a_score_on_a_flat_road_can_be_shown(tmp_path):
    car = Network.load("quarter-car-isd")
    still = {"reference": passive(car), "road": "flat", "episodes": 1, "duration": 1.0}
    flat = score([find("isd-passive", car)], car, **still)
    page = check_page(score_page.score_report(flat, tmp_path / "flat"))
    assert "No policy shown here costs less than passive." in page.text
    assert not (tmp_path / "flat" / "spectra.svg").exists()  # nothing moves


def test_headline_names_who_is_level_with_the_best(small_score):
    shown = score_page.Shown(small_score)
    assert (
        shown.reference == "passive" and shown.best == "skyhook" and shown.level == []
    )
    assert shown.headline.startswith("skyhook costs ")
    shown.costs["isd-passive"] = shown.costs["skyhook"] * np.array([0.98, 1.04, 1.0])
    assert shown.level == ["isd-passive"] and "Level with it" in shown.headline


def test_spectral_density_holds_the_variance():
    """The integral over frequency is the mean square, for noise and for a sine."""
    t = 5e-3 * np.arange(8000)
    noise = np.random.default_rng(0).standard_normal((8000, 4))
    for x in (noise, 3 * np.sin(2 * np.pi * 4.0 * t)):
        f, p = plots.density(x, 5e-3)
        edges = np.concatenate([[0.0], 0.5 * (f[1:] + f[:-1]), [100.0]])
        assert np.sum(p * np.diff(edges)) == pytest.approx(np.mean(x**2), rel=0.06)
    assert f[np.argmax(p)] == pytest.approx(4.0, rel=0.03)


def test_the_user_s_matplotlibrc_changes_no_figure():
    import matplotlib

    own = {
        "text.usetex": True,
        "axes.spines.left": False,
        "path.sketch": (1, 100, 2),
        "figure.dpi": 1e5,
    }
    with matplotlib.rc_context(own):
        with plots.style():
            within = dict(matplotlib.rcParams)
        assert matplotlib.rcParams["axes.spines.left"] is False  # the user's outside
    with plots.style():
        assert within == dict(matplotlib.rcParams)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (-1.5, "−1.50"), (296.61, "297"), (1234.5, "1234"), (0.00123, "0.00123"), (2.5e7, "2.50·10⁷"),
     (1.2e-6, "1.20·10⁻⁶"), (float("inf"), "–"), (None, "–")],
)  # fmt: skip
def test_numbers_are_printed_without_exponents(value, text):
    assert plots.number(value) == text


@pytest.fixture
def told(diagnosis, monkeypatch, quick):
    """What the command hands to the workflow, which is not run."""
    calls = []

    def fake(data, model, **options):
        calls.append((data, model, options))
        options["progress"]("working")
        return diagnosis

    monkeypatch.setattr("isd_gym.diagnosis.diagnose", fake)
    return calls


def tables(folder, *names, head="time,road,current,{}"):
    outputs = [c.name for c in Network.load("quarter-car-isd").outputs]
    rows = "\n".join(
        f"{0.01 * k:.2f}," + ",".join(["1.0"] * (len(outputs) + 2)) for k in range(5)
    )
    for name in names:
        (folder / name).write_text(head.format(",".join(outputs)) + "\n" + rows + "\n")


def test_diagnose_takes_records_as_documented(told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tables(tmp_path, "a.csv", "b.csv", "c.csv", "d.csv")
    fit = "diagnose a.csv b.csv --model quarter-car-isd --out found"
    text = printed(fit, "--validate c.csv d.csv --json x.json")
    data, model, options = told[0]
    assert [t.source for t in data] == [
        "a.csv",
        "b.csv",
    ] and model.name == "quarter-car-isd"
    assert [t.source for t in options["validate"]] == ["c.csv", "d.csv"]
    assert "The model lacks coulomb friction" in text and "noise floor" in text
    assert read_json(Path("x.json"))["schema"] == "isd-diagnosis/1"
    assert Path("found/report.html").exists()
    tables(tmp_path, "a.csv", head="time,z_r,current,{}")
    printed(
        "diagnose a.csv --model quarter-car-isd --out found --rename z_r=road --unit road=mm"
    )
    assert told[-1][0][0]["road"] == pytest.approx(1e-3)
    tables(tmp_path, "a.csv")
    for also in ("--validate c.csv --validate=d.csv", "--validate=c.csv d.csv"):
        printed(fit, also)
        assert [t.source for t in told[-1][2]["validate"]] == ["c.csv", "d.csv"]
        assert [t.source for t in told[-1][0]] == ["a.csv", "b.csv"]


def test_diagnose_whose_report_fails_tells_the_verdict_and_ends_in_1(
    told, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    tables(tmp_path, "a.csv")

    def fail(*args, **options):
        raise NameError("name 'Effect' is not defined")

    monkeypatch.setattr(report, "page", fail)
    done = run("diagnose a.csv --model quarter-car-isd --out found --json x.json")
    assert done.returncode == 1
    for words in ("The model lacks coulomb friction", "noise floor"):
        assert words in done.stdout
    # a slow machine tells its progress before
    assert done.stderr.splitlines()[-1] == (
        "isd-gym: the report could not be drawn (NameError: name 'Effect' is not defined); the results are in 'found'"
    )
    for file in ("x.json", "found/diagnosis.json"):
        assert read_json(Path(file))["verdict"] == "missing_effect"
    assert Network.load("found/model.json").element("seal").level == LEVEL


def test_a_curve_of_many_samples_keeps_its_extremes():
    x = np.arange(50_000) * 1e-3
    y = np.sin(x) + 0.1 * np.random.default_rng(0).standard_normal(x.size)
    y[12_345] = 5.0
    line = charts.Line("x", x, y, charts.QUIET)
    few_x, few_y = charts._thinned(line, charts.Axis())
    assert (
        few_x.size <= 2.1 * charts.COLUMNS
        and few_y.max() == 5.0
        and few_y.min() == y.min()
    )
    part, _ = charts._thinned(line, charts.Axis(low=10.0, high=10.5))
    assert part.size == 503 and part[0] <= 10.0 and part[-1] >= 10.5


def test_one_episode_has_no_interval(tmp_path):
    car = Network.load("quarter-car-isd")
    one = score(
        [find("skyhook", car)], car, reference=passive(car), episodes=1, duration=3.0
    )
    page = check_page(score_page.score_report(one, tmp_path / "one"))
    assert "One episode has no interval" in page.text and "95 % paired" not in page.text
    items = score_page.trade_off(score_page.Shown(one)).panels[0].items
    points = [i for i in items if isinstance(i, charts.Marks)]
    assert points and not any(i.x_interval for i in points)
