"""pysindy and SysIdentPy on the records the diagnosis is graded on, used as their documentation has it.

python benchmarks/peers.py FOLDER [NAME ...] [--ours FILE] [--json FILE]

`--ours`: what `benchmarks/diagnose.py FOLDER --json FILE` wrote. Needs `pip install -e ".[peers]"`. pysindy looks for
forces: sparse regression of a balance of forces on terms of every pair of terminals whose motion is measured or follows
from what is; what it keeps is graded by the rule of the diagnosis. SysIdentPy predicts: a polynomial NARX per output, run
free over the validation record; it has no name for an effect.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.signal import decimate, savgol_filter

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from grading import grade, graded, named, pair

from isd_gym._common.errors import InputError
from isd_gym.diagnosis._estimation.structure import add, base_structure
from isd_gym.diagnosis._hypotheses.library import hypotheses
from isd_gym.physics.elements import beside as standing
from isd_gym.physics.network import Network
from isd_gym.physics.simulate import simulate
from isd_gym.records.data import Table, read_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

SETTLE = 2.0  # s of a record that are not compared: the models begin at rest
WINDOW = 21  # samples of the Savitzky-Golay filter
# of the RMS of what is to be explained, where every variable has RMS 1
THRESHOLDS = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5)
SLACK = 1.5  # the sparsest equation whose error on the validation record is within this factor of the best
#: every so many samples, degree, lags, each with displacements and with their rates as inputs
NARX = [(4, 1, n) for n in (4, 8, 12)] + [(10, 1, n) for n in (4, 6, 10)] + [(4, 2, 2), (4, 2, 4), (10, 2, 3)]

Pair = tuple[str, str]
Term = tuple[Pair, str]
Motion = dict[str, np.ndarray]  # kind of variable -> samples
#: term -> (kind of variable, effect it stands for, function of the variable at RMS 1)
LIBRARY: dict[str, tuple[str, str, Callable[[np.ndarray], np.ndarray]]] = {
    "d": ("d", "linear_stiffness", lambda d: d),
    "d^2": ("d", "gas_spring", lambda d: d**2),
    "d^3": ("d", "cubic_stiffness", lambda d: d**3),
    "hinge(d)": ("d", "bump_stop", lambda d: np.sign(d) * np.maximum(np.abs(d) - 2.0, 0.0)),
    "v": ("v", "linear_damping", lambda v: v),
    "|v|": ("v", "asymmetric_damping", lambda v: np.abs(v)),
    "v|v|": ("v", "quadratic_damping", lambda v: v * np.abs(v)),
    "sign(v)": ("v", "coulomb_friction", lambda v: np.sign(v)),
    "a": ("a", "inertance", lambda a: a),
    "I": ("I", "", lambda i: i),
    "I^3": ("I", "thrust_saturation", lambda i: i**3),
    "I'": ("I'", "actuator_lag", lambda i: i),
    "F''": ("F''", "series_compliance", lambda f: f),  # spring k in series with inertance b: -(b/k) F''
}
LINEAR = {"linear_stiffness": "stiffness d", "linear_damping": "damping v", "inertance": "inertance a"}


class Balance(NamedTuple):
    """target [N] = a sum of terms of `variables`; `names`: the pairs whose effects it may name."""

    target: np.ndarray
    names: set[Pair]
    variables: dict[Term, np.ndarray]


def effects_of(terms: Iterable[Term], model: Network) -> set[tuple[str, Pair]]:
    """Effects that terms stand for; a force that the model has already is no news."""
    named = {(LIBRARY[t][1], p) for p, t in terms if LIBRARY[t][1]}
    return {(what, p) for what, p in named if what not in {e.type for e in standing(model, p)}}


def known(model: Network, p: Pair, m: Motion) -> np.ndarray:
    """Force [N] of the model's own elements at a pair that moves so."""
    own: list[Any] = standing(model, p)
    linear = [(e, *LINEAR[e.type].split()) for e in own if e.type in LINEAR]
    forces = [getattr(e, factor) * m[kind] for e, factor, kind in linear]
    forces += [e.level * np.sign(m["v"]) for e in own if e.type == "coulomb_friction"]
    forces += [e.thrust_constant * e.ratio * m["I"] for e in own if e.type == "motor"]
    return np.asarray(sum(forces, np.zeros_like(m["d"])))


def balances(model: Network, table: Table) -> list[Balance]:
    """Force balances of the quarter car or the force rig, less the owner's forces: what pysindy is to explain.

    Columns are smoothed and differentiated by pysindy's means. Motion that is not measured is had from what is, with the
    owner's stiffness: the tyre's from its force, the damper's from both travels and the compression of the oil.
    """
    import pysindy as ps

    by = {c.name: savgol_filter(table[c.name], WINDOW, 3) for c in model.inputs + model.outputs}
    slope = ps.SmoothedFiniteDifference(smoother_kws={"window_length": WINDOW, "polyorder": 3})
    springs: dict[str, Any] = {e.name: e for e in model.elements if e.type == "linear_stiffness"}

    def rate(x: np.ndarray) -> np.ndarray:
        return np.asarray(slope(x[:, None], table.step * np.arange(len(x))))[:, 0]

    def motion(x: np.ndarray, **more: np.ndarray) -> Motion:
        return {"d": x, "v": rate(x), "a": rate(rate(x)), **more}

    def balance(target: np.ndarray, names: set[Pair], moves: dict[Pair, Motion]) -> Balance:
        inert = {p for p in moves if any(e.type == "inertance" for e in standing(model, p))}
        variables = {(p, k): x for p, m in moves.items() for k, x in m.items() if k != "a" or p in inert}
        return Balance(target + sum(known(model, p, m) for p, m in moves.items()), names, variables)

    if {"body", "wheel"} <= set(model.masses):
        strut, device = ("body", "wheel"), ("piston", "joint")
        damper, tyre = ("joint", "wheel"), ("wheel", "road")
        a, s, w, i = (by[n] for n in ("body_acceleration", "suspension_travel", "device_travel", "current"))
        body, m = model.masses["body"] * a, motion(s)
        oil = -(body + springs["main_spring"].stiffness * s) / springs["oil"].stiffness
        wheel = model.masses["wheel"] * (a - m["a"])
        return [
            balance(body, {strut, device}, {strut: m, device: motion(w, **{"I": i, "I'": rate(i)})}),
            balance(body, {strut, damper}, {strut: m, damper: motion(s - w - oil)}),
            balance(body + wheel, {tyre}, {tyre: motion(by["tyre_force"] / springs["tyre"].stiffness)}),
        ]
    if len(model.inputs) == len(model.outputs) == 1 and model.outputs[0].at == model.inputs[0].at:
        x, f, node = by[model.inputs[0].name], by[model.outputs[0].name], model.outputs[0].at or ""
        for e in (e for e in springs.values() if node in e.where):  # in series: it bears the whole force
            x, node = x - f / e.stiffness, next(n for n in e.where if n != node)
        here = (node, "ground")
        return [balance(-f, {here}, {here: motion(x, **{"F''": rate(rate(f))})})]
    raise InputError(f"{model.name}: only the quarter car and the force rig have their balances written here")


def sparse(fit: Balance, check: Balance, like: Balance) -> set[Term]:
    """Terms that STLSQ keeps: the sparsest equation near the best on `check`; thresholds are shares of `like`."""
    import pysindy as ps

    keys = list(fit.variables)
    scale = np.array([max(float(np.std(like.variables[k])), 1e-300) for k in keys])
    x, x_check = (np.column_stack([b.variables[k] for k in keys]) / scale for b in (fit, check))
    y, y_check = (b.target[:, None] / np.std(like.target) for b in (fit, check))
    libraries = [ps.CustomLibrary([f for k, _, f in LIBRARY.values() if k == kind]) for _, kind in keys]
    constant = ps.PolynomialLibrary(degree=0)
    columns = [*([j] for j in range(len(keys))), [0]]
    names = [(p, t) for p, kind in keys for t in LIBRARY if LIBRARY[t][0] == kind]
    equations = []
    for level in THRESHOLDS:
        library = ps.GeneralizedLibrary([*libraries, constant], inputs_per_library=columns)
        sindy = ps.SINDy(optimizer=ps.STLSQ(threshold=level), feature_library=library)
        sindy.fit(x, t=1.0, x_dot=y)
        kept = sindy.coefficients()[0][: len(names)] != 0  # the constant, which comes last, has no place
        error = nrmse(np.asarray(sindy.predict(x_check)), y_check)
        equations.append((error, {n for n, k in zip(names, kept, strict=True) if k}))
    best = min(error for error, _ in equations)
    return min((terms for error, terms in equations if error <= SLACK * best), key=len)


def twin(model: Network, table: Table, rng: np.random.Generator) -> Table:
    """The owner's model on the record's inputs, with as much white noise as smoothing takes off the record."""
    inputs = {c.name: table[c.name] for c in model.inputs}
    outputs = simulate(model, table.time, inputs)
    for name, y in outputs.items():
        noise = np.std(table[name] - savgol_filter(table[name], WINDOW, 3))
        outputs[name] = y + noise * rng.standard_normal(len(y))
    return Table(table.time, inputs | outputs, "twin")


def sindy_names(model: Network, records: list[Table]) -> list[tuple[str, Pair]]:
    """Effects that pysindy keeps on the records (estimation, validation), and not on the model's own twin of them."""
    rng = np.random.default_rng(7)
    real = [balances(model, t) for t in records]
    own = [balances(model, twin(model, t, rng)) for t in records]
    votes: Counter[tuple[str, Pair]] = Counter()
    asked: Counter[Pair] = Counter()
    for fit, check, fit_twin, check_twin in zip(*real, *own, strict=True):
        news = effects_of(sparse(fit, check, fit) - sparse(fit_twin, check_twin, fit), model)
        asked.update(fit.names)
        votes.update(v for v in news if v[1] in fit.names)
    # where two balances hold a pair, both must say so
    return sorted(v for v, n in votes.items() if n == asked[v[1]])


def nrmse(simulated: np.ndarray, measured: np.ndarray, skip: float = 0) -> float:
    """Deviation of the difference over that of what was measured, without the first `skip` samples.

    A constant is not counted: the device of the car has no position of rest, it stays where it began.
    """
    s, m = simulated[int(skip) :].ravel(), measured[int(skip) :].ravel()
    return float(np.std(s - m) / np.std(m))


def model_nrmse(model: Network, table: Table) -> dict[str, float]:
    outputs = simulate(model, table.time, {c.name: table[c.name] for c in model.inputs})
    return {name: nrmse(y, table[name], SETTLE / table.step) for name, y in outputs.items()}


def narx_nrmse(model: Network, records: list[Table]) -> dict[str, float]:
    """SysIdentPy's free run over the validation record: for every output the best of the scan on that very record."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    best = {c.name: float("inf") for c in model.outputs}
    for (every, degree, lag), rates in ((n, r) for n in NARX for r in (False, True)):
        X, Y = [], []
        for r in records:
            u = [decimate(r[c.name], every, ftype="fir") for c in model.inputs]
            moved = [rates and c.quantity == "displacement" for c in model.inputs]
            X.append(np.column_stack([np.gradient(x) if m else x for x, m in zip(u, moved, strict=True)]))
            Y.append({n: decimate(r[n], every, ftype="fir")[:, None] for n in best})
        size = np.maximum(X[0].std(axis=0), 1e-12)
        lags: Any = lag if len(model.inputs) == 1 else [list(range(1, lag + 1))] * len(model.inputs)
        for n in best:
            scale = Y[0][n].std()
            how: dict[str, Any] = {"estimator": LeastSquares(), "basis_function": Polynomial(degree=degree)}
            narx = FROLS(ylag=lag, xlag=lags, info_criteria="bic", **how)
            narx.fit(X=X[0] / size, y=Y[0][n] / scale)
            run = narx.predict(X=X[1] / size, y=Y[1][n] / scale) * scale
            error = nrmse(run, Y[1][n], SETTLE / (every * records[1].step))
            best[n] = min(best[n], error if np.isfinite(error) else float("inf"))
    return best


def diagnosed(model: Network, row: dict[str, Any]) -> Network:
    """The model that the diagnosis ended with, from its row in the benchmark's file."""
    said = row["diagnosis"]
    structure = base_structure(model.with_parameters({k: q["value"] for k, q in said["parameters"].items()}))
    for e, (what, where) in zip(said["effects"], named(row), strict=True):
        now = structure.network
        motors = {e.name: e.where for e in now.elements}
        values = {k: q["value"] for k, q in e["parameters"].items()}
        h = next(
            h for h in hypotheses(now) if h.effect == what and pair(motors.get(h.where[0], h.where)) == where
        )
        structure = add(structure, h, values)
    return structure.network


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--ours", type=Path)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    warnings.simplefilter("ignore")  # both libraries warn of every setting that does not suit a record
    truth = json.loads((args.folder / "truth.json").read_text())
    ours = {r["name"]: r for r in json.loads(args.ours.read_text())["rows"]} if args.ours else {}
    rows: list[dict[str, Any]] = []
    for name in sorted(truth, key=lambda s: s[-3:]):
        if args.names and not any(n in name for n in args.names):
            continue
        model, answer = Network.load(args.folder / name / "model.json"), truth[name]["answer"]
        records = [read_table(args.folder / name / f"{part}.csv") for part in ("estimation", "validation")]
        said = sindy_names(model, records)
        found = [(what, pair(p)) for what, p in said]
        g = grade("missing_effect" if found else "no_discrepancy", found, answer)
        hidden = [] if answer == "unknown" else answer
        held = bool(hidden) and all(any(grade("", [f], [h]) == "right" for f in found) for h in hidden)
        row = {"name": name, "answer": answer, "found": said, "grade": g, "among": held}
        row["nrmse"] = {"model": model_nrmse(model, records[1]), "NARX": narx_nrmse(model, records)}
        print(f"{name} {truth[name]['kind']} <- {answer}\n  pysindy    {g:6s} {said}")
        if "diagnosis" in ours.get(name, {}):
            print(f"  diagnosis  {graded(ours[name]):6s} {named(ours[name])}")
            row["nrmse"]["diagnosed"] = model_nrmse(diagnosed(model, ours[name]), records[1])
        for k, v in row["nrmse"].items():
            print(f"  {k:10s} " + ", ".join(f"{c} {x:.3f}" for c, x in v.items()), flush=True)
        rows.append(row)
    among = sum(r["among"] for r in rows)
    print("\npysindy  ", dict(Counter(r["grade"] for r in rows)), "answer among the named:", among)
    print("diagnosis", dict(Counter(graded(ours[r["name"]]) for r in rows if r["name"] in ours)))
    for k in ("model", "NARX", "diagnosed"):
        values = [x for r in rows for x in r["nrmse"].get(k, {}).values()]
        if values:
            print(f"{k:10s} median NRMSE {np.median(values):.3f} over {len(values)} channels")
    if args.json:
        args.json.write_text(json.dumps(rows, default=list, indent=1))


if __name__ == "__main__":
    main()
