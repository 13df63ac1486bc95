"""Tools on MissingPhysBench: one function per tool, from the folder of a case to its answer and prediction.

Only `isd_gym` needs this project. The others need numpy, scipy and numba, and the package of the tool: pysindy, sysidentpy,
gplearn or scikit-learn.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import resource
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
from missing_physics import STATED, read_csv

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

Columns = dict[str, np.ndarray]
Answer = dict[str, Any]


#: packages that a tool is made of
PACKAGES = {
    "isd_gym": ("isd-gym",),
    "sindy": ("pysindy",),
    "symbolic": ("gplearn",),
    "gp": ("scikit-learn",),
    "narx": ("sysidentpy",),
}


def versions(tool: str) -> dict[str, str]:
    """Return the versions of the packages of a tool."""
    return {
        name: importlib.metadata.version(name)
        for name in (*PACKAGES.get(tool, ()), "numpy", "scipy")
    }


def processor_seconds() -> float:
    """Return the processor time since the last call [s]."""
    now = resource.getrusage(resource.RUSAGE_SELF)
    total = now.ru_utime + now.ru_stime
    used, processor_seconds.last = (
        total - getattr(processor_seconds, "last", 0.0),
        total,
    )  # type: ignore[attr-defined]
    return used


# ----------------------------------------------------------------------------------------------------------- isd_gym
def isd_gym(case: Path, out: Path) -> tuple[Answer, Columns]:
    """`isd-gym diagnose`, with the second record held out, and `isd-gym simulate` on the test input.

    A named effect states its `confidence`. A place without a name is stated where the table of an unknown force is, and where the
    diagnosis gives a place a probability of `STATED` at least.
    """
    found, predicted = out / "found", out / "simulated.csv"
    begun = resource.getrusage(resource.RUSAGE_CHILDREN)
    program = [sys.executable, "-m", "isd_gym"]
    records = [case / "train.csv", "--validate", case / "validation.csv"]
    words = [
        "diagnose",
        *records,
        "--model",
        case / "model.json",
        "--out",
        found,
        "--jobs",
        1,
    ]
    _call([*program, *words], found)
    _call(
        [
            *program,
            "simulate",
            found / "model.json",
            case / "test_input.csv",
            "--out",
            predicted,
        ],
        found,
    )
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    said = json.loads((found / "diagnosis.json").read_text(encoding="utf-8"))
    effects = [
        {
            "law": e["effect"],
            "place": e.get("channel") or e["between"] or ["anywhere"],
            "probability": e["confidence"],
        }
        for e in said["effects"]
    ]
    stated = {
        tuple(sorted([e["place"]] if isinstance(e["place"], str) else e["place"]))
        for e in effects
    }
    open_places = [
        (f["place"], f["place_probability"])
        for f in said["findings"]
        if f["place"] and f["place_probability"] >= STATED
    ]
    if said["tabulated"]:
        open_places.append((said["tabulated"]["between"], 1.0))
    for place, probability in open_places:
        if tuple(sorted(place)) not in stated:
            stated.add(tuple(sorted(place)))
            effects.append({"law": None, "place": place, "probability": probability})
    model = json.loads((case / "model.json").read_text(encoding="utf-8"))
    answer = {
        "effects": effects,
        "verdict": said["verdict"],
        "parameters": {
            k: q["value"]
            for k, q in said["parameters"].items()
            if k in model["uncertainty"]
        },
        "seconds": ended.ru_utime + ended.ru_stime - begun.ru_utime - begun.ru_stime,
    }
    return answer, read_csv(predicted)


def _call(words: list[Any], found: Path) -> None:
    """Run a command; its output goes into a file beside the result."""
    done = subprocess.run(
        list(map(str, words)),
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    with found.with_suffix(".log").open("a", encoding="utf-8") as log:
        log.write(done.stdout + done.stderr)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no message"])[-1])


# --------------------------------------------------------------------------------------------------- common to rivals
#: a term, a law or a force is kept if the free run over the validation record errs by so much less than without it
GAIN = 0.1
#: number of samples that Gaussian process and symbolic regression are fitted to
POINTS = 300


class Rig:
    """A case with its records and its refitted model."""

    def __init__(self, case: Path) -> None:
        from missing_physics_plant import Plant

        self.plant = Plant(case)
        self.train, self.validation, self.test = (
            read_csv(case / f"{n}.csv") for n in ("train", "validation", "test_input")
        )
        self.theta, _, self.deviance, self.weight = self.plant.fit([self.train])
        self.refit_error = self.plant.error(self.theta, [], self.validation)

    def answer(
        self, effects: list[dict[str, Any]], theta: np.ndarray, extras: list[Any]
    ) -> tuple[Answer, Columns]:
        """Return the answer, with the prediction of the model with extras."""
        parameters = self.plant.values(theta)
        outputs = self.plant.simulate(theta, extras, self.test)
        return {"effects": effects, "parameters": parameters}, {
            "time": self.test["time"],
            **outputs,
        }

    def best(
        self, attempt: Callable[[], tuple[list[dict[str, Any]], np.ndarray, list[Any]]]
    ) -> tuple[Answer, Columns]:
        """Return the answer of the window of the differentiating filter with the smallest error over the validation record.

        The refitted model stands unless the free run over the validation record errs by `GAIN` less.

        Args:
            attempt: Function without arguments that returns effects, parameters and extras for the present window.
        """
        from missing_physics_plant import WINDOWS

        least, found = (1.0 - GAIN) * self.refit_error, ([], self.theta, [])
        for self.plant.window in WINDOWS:
            effects, theta, extras = attempt()
            error = self.plant.error(theta, extras, self.validation)
            if error < least:
                least, found = error, (effects, theta, extras)
        return self.answer(*found)

    def forces(
        self, table: Columns
    ) -> tuple[Columns, dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]]:
        return self.plant.residual_forces(self.theta, table)

    def target(self, forces: Columns, place: tuple[str, str]) -> np.ndarray:
        """Return the force at a place that explains most of the residual forces on its masses."""
        sides = [
            sign * forces[n]
            for n, sign in zip(place, (-1.0, 1.0), strict=True)
            if n in forces
        ]
        return np.mean(sides, axis=0)

    def unexplained(
        self, forces: Columns, place: tuple[str, str], force: np.ndarray
    ) -> float:
        """Return the sum of squares that a force at a place leaves, every mass relative to its own."""
        total = 0.0
        for n, r in forces.items():
            sign = {place[0]: 1.0, place[1]: -1.0}.get(n, 0.0)
            total += float(np.mean((r + sign * force) ** 2) / np.mean(r**2))
        return total


def refit(case: Path, out: Path) -> tuple[Answer, Columns]:
    """The nominal model with its parameters refitted: nothing is named."""
    rig = Rig(case)
    return rig.answer([], rig.theta, [])


def has_linear(plant: Any, law: str, place: tuple[str, ...]) -> bool:
    """Return whether the model has an element of this law at the place."""
    return any(
        e["type"] == law and set(e["between"]) == set(place)
        for e in plant.model["elements"]
    )


# --------------------------------------------------------------------------------------- AIC over the fixed list of laws
def aic(case: Path, out: Path) -> tuple[Answer, Columns]:
    """Every law of a fixed list at every place, fitted by output error; forward selection of at most two by AIC.

    Both records are fitted. The probability of a name is its Akaike weight among all candidates of its step.
    """
    from missing_physics_plant import LAWS, Extra

    rig = Rig(case)
    plant, tables = rig.plant, [rig.train, rig.validation]
    theta, chosen, best, weight = plant.fit(tables)
    _, at = rig.forces(rig.train)
    forces, _ = rig.forces(rig.train)
    size = float(np.mean([np.std(f) for f in forces.values()]))
    effects: list[dict[str, Any]] = []
    count = 0
    for _ in range(2):
        tried = []
        for extra in candidates(plant, at, size, LAWS, Extra):
            if any((e.law, e.place) == (extra.law, extra.place) for e in chosen):
                continue
            t, extras, deviance, w = plant.fit(tables, [*chosen, extra], weight)
            if np.isfinite(deviance):
                tried.append((deviance + 2 * (count + len(extra.values)), t, extras, w))
        values = np.array([best, *(value for value, *_ in tried)])
        weights = np.exp(-0.5 * (values - values.min()))
        weights /= weights.sum()
        k = int(np.argmin(values))
        if k == 0:
            break
        best, theta, chosen, weight = tried[k - 1]
        count += len(chosen[-1].values)
        place = chosen[-1].place
        effects.append(
            {
                "law": chosen[-1].law,
                "place": place[0] if len(place) == 1 else list(place),
                "probability": float(weights[k]),
            }
        )
    return rig.answer(effects, theta, chosen)


def candidates(plant: Any, at: Any, size: float, laws: Any, extra: Any) -> list[Any]:
    """Return every law at every place with starting values, and gain and delay of every channel."""
    out = []
    for place, (d, v) in at.items():
        travel, rate, f = float(np.std(d)), float(np.std(v)), 0.3 * size
        start = {
            "coulomb_friction": (f,),
            "stribeck_friction": (f, 2 * f, 0.3 * rate),
            "quadratic_damping": (f / rate**2,),
            "asymmetric_damping": (f / rate,),
            "cubic_stiffness": (f / travel**3,),
            "bump_stop": (1.2 * travel, 3 * f / travel),
            "linear_damping": (f / rate,),
            "linear_stiffness": (f / travel,),
        }
        out += [
            extra(law, place, start[law])
            for law in laws
            if not has_linear(plant, law, place)
        ]
    step = 2.0 * plant.step
    for o in plant.outputs:
        out += [
            extra("sensor_gain", (o["name"],), (1.0,)),
            extra("sensor_delay", (o["name"],), (step,)),
        ]
    return out


# --------------------------------------------------------------------------------------------------- sparse regression
def sindy(case: Path, out: Path) -> tuple[Answer, Columns]:
    """pysindy on the residual forces: library and sequentially thresholded least squares; the known part is subtracted.

    Thresholds are shares of the residual force; the sparsest equation within 1.5 times the best error on the validation record is
    kept. Coefficients are then fitted by output error.
    """
    rig = Rig(case)
    terms = {
        "d": ("linear_stiffness", lambda d, v: d),
        "v": ("linear_damping", lambda d, v: v),
        "d^3": ("cubic_stiffness", lambda d, v: d**3),
        "hinge(d)": (
            "bump_stop",
            lambda d, v: np.sign(d) * np.maximum(np.abs(d) - 2.0, 0.0),
        ),
        "sign(v)": ("coulomb_friction", lambda d, v: np.sign(v)),
        "v|v|": ("quadratic_damping", lambda d, v: v * np.abs(v)),
        "max(v,0)": ("asymmetric_damping", lambda d, v: np.maximum(v, 0.0)),
    }
    return rig.best(lambda: equation(rig, terms))


def equation(
    rig: Rig, terms: dict[str, Any]
) -> tuple[list[dict[str, Any]], np.ndarray, list[Any]]:
    """Return the effects of the sparse equation, and parameters and extras fitted by output error."""
    import pysindy as ps
    from missing_physics_plant import Extra

    like, motion = rig.forces(rig.train)
    scale = {p: (float(np.std(d)), float(np.std(v))) for p, (d, v) in motion.items()}
    size = {n: float(np.std(f)) for n, f in like.items()}

    def system(table: Columns) -> tuple[np.ndarray, np.ndarray]:
        forces, at = rig.forces(table)
        columns = []
        for place, (d, v) in at.items():
            for _, term in terms.values():
                force = term(d / scale[place][0], v / scale[place][1])
                sides = {place[0]: -1.0, place[1]: 1.0}
                # every equation relative to the size of its residual force
                columns.append(
                    np.concatenate(
                        [
                            sides.get(n, 0.0) * force * min(size.values()) / size[n]
                            for n in forces
                        ]
                    )
                )
        return np.column_stack(columns), np.concatenate(
            [forces[n] / size[n] for n in forces]
        )

    names = [(p, t) for p in motion for t in terms]
    (X, y), (X_check, y_check) = system(rig.train), system(rig.validation)
    norm = np.sqrt(np.mean(X**2, axis=0)) + 1e-300
    library = ps.IdentityLibrary()
    found = []
    for level in (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5):
        model = ps.SINDy(
            optimizer=ps.STLSQ(threshold=level, alpha=1e-6), feature_library=library
        )
        model.fit(X / norm, t=1.0, x_dot=y[:, None])
        c = model.coefficients()[0]
        error = float(np.sqrt(np.mean((X_check / norm @ c - y_check) ** 2)))
        found.append(
            (
                error,
                [n for n, k in zip(names, c, strict=True) if k != 0],
                dict(zip(names, c / norm, strict=True)),
            )
        )
    least = min(error for error, *_ in found)
    _, kept, coefficients = min(
        (f for f in found if f[0] <= 1.5 * least), key=lambda f: len(f[1])
    )
    extras = []
    for place, term in kept:
        law, (travel, rate) = terms[term][0], scale[place]
        if has_linear(rig.plant, law, place):
            continue
        c = coefficients[place, term] * min(size.values())
        by = {
            "d": travel,
            "v": rate,
            "d^3": travel**3,
            "sign(v)": 1.0,
            "v|v|": rate**2,
            "max(v,0)": rate,
            "hinge(d)": travel,
        }
        extras.append(
            Extra(
                law,
                place,
                (2.0 * travel, c / travel) if law == "bump_stop" else (c / by[term],),
            )
        )
    theta, fitted, _, _ = rig.plant.fit([rig.train], extras)
    return [{"law": e.law, "place": list(e.place)} for e in fitted], theta, fitted


# ------------------------------------------------------------------------- one force over distance and rate at one place
def surface(
    rig: Rig,
    fit: Callable[[np.ndarray, np.ndarray], Callable[[np.ndarray], np.ndarray]],
) -> Any:
    """Fit a force over distance and rate at every place, and return the place that explains most of the validation record.

    Args:
        rig: The case.
        fit: Function of features (samples, 2) at unit deviation and of target at unit deviation, which returns a predictor.

    Returns:
        Place, table of the force as an extra, and the predictor in units of the features and of the target.
    """
    from missing_physics_plant import Extra

    forces, at = rig.forces(rig.train)
    check, there = rig.forces(rig.validation)
    found = []
    for place, (d, v) in at.items():
        travel, rate, target = (
            float(np.std(d)),
            float(np.std(v)),
            rig.target(forces, place),
        )
        size = float(np.std(target))
        pick = np.linspace(0, len(d) - 1, min(POINTS, len(d))).astype(int)
        predict = fit(
            np.column_stack([d / travel, v / rate])[pick], target[pick] / size
        )
        force = size * predict(
            np.column_stack([there[place][0] / travel, there[place][1] / rate])
        )
        reach = [
            1.2 * max(np.max(np.abs(q[k])) for q in (at[place], there[place]))
            for k in range(2)
        ]
        axes = [np.linspace(-r, r, 61) for r in reach]
        mesh = np.column_stack(
            [
                q.ravel()
                for q in np.meshgrid(axes[0] / travel, axes[1] / rate, indexing="ij")
            ]
        )
        grid = size * predict(mesh).reshape(61, 61)
        found.append(
            (
                rig.unexplained(check, place, force),
                place,
                Extra("table", place, tuple(reach), grid),
                predict,
                (travel, rate),
            )
        )
    return min(found, key=lambda f: f[0])[1:]


def gp(case: Path, out: Path) -> tuple[Answer, Columns]:
    """Gaussian process (scikit-learn) of the residual force over distance and rate, at the place that explains most: no law."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    def fit(X: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        kernel = ConstantKernel(1.0) * RBF([1.0, 1.0], (0.1, 30.0)) + WhiteKernel(0.3)
        return GaussianProcessRegressor(kernel, random_state=0).fit(X, y).predict

    rig = Rig(case)

    def attempt() -> tuple[list[dict[str, Any]], np.ndarray, list[Any]]:
        place, extra, _, _ = surface(rig, fit)
        return [{"law": None, "place": list(place)}], rig.theta, [extra]

    return rig.best(attempt)


def symbolic(case: Path, out: Path) -> tuple[Answer, Columns]:
    """gplearn of the residual force over distance and rate, at the place that explains most.

    The law is that of the fixed list which, together with a line in distance and rate, is closest to the expression; there is no law
    where a quarter of the expression beyond the line is left.
    """
    from gplearn.functions import make_function
    from gplearn.genetic import SymbolicRegressor

    sign = make_function(function=lambda x: np.sign(x), name="sign", arity=1)

    def fit(X: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        model = SymbolicRegressor(
            population_size=500, generations=15, function_set=("add", "sub", "mul", "abs", "max", "min", sign),
            metric="mse", parsimony_coefficient=0.002, random_state=0,
        )  # fmt: skip
        model.fit(X, y)
        with (out / "expressions.txt").open("a", encoding="utf-8") as file:
            file.write(f"{model._program}\n")
        return model.predict

    rig = Rig(case)

    def attempt() -> tuple[list[dict[str, Any]], np.ndarray, list[Any]]:
        place, extra, predict, (travel, rate) = surface(rig, fit)
        _, at = rig.forces(rig.train)
        d, v = at[place][0] / travel, at[place][1] / rate
        law = closest_law(d, v, predict(np.column_stack([d, v])))
        return [{"law": law, "place": list(place)}], rig.theta, [extra]

    return rig.best(attempt)


def closest_law(d: np.ndarray, v: np.ndarray, force: np.ndarray) -> str | None:
    """Return the law that is closest to a force, beside a line in distance and rate; None where a quarter of the rest is left.

    Args:
        d: Distance at unit deviation.
        v: Rate at unit deviation.
        force: Force.
    """
    shapes = {
        "coulomb_friction": np.sign(v),
        "quadratic_damping": v * np.abs(v),
        "asymmetric_damping": np.maximum(v, 0.0),
        "cubic_stiffness": d**3,
        "bump_stop": np.sign(d) * np.maximum(np.abs(d) - 1.5, 0.0),
    }
    line = np.column_stack([np.ones(len(d)), d, v])

    def left(*more: np.ndarray) -> float:
        X = np.column_stack([line, *more])
        return float(
            np.mean((force - X @ np.linalg.lstsq(X, force, rcond=None)[0]) ** 2)
        )

    beyond, (least, law) = left(), min((left(x), n) for n, x in shapes.items())
    is_line = beyond < 0.01 * float(np.var(force))
    return None if is_line or least > 0.25 * beyond else law


# -------------------------------------------------------------------------------------------------------------- NARX
def narx(case: Path, out: Path) -> tuple[Answer, Columns]:
    """SysIdentPy: a polynomial NARX per output, chosen by its free run over the validation record. No place, no law."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    train, validation, test = (
        read_csv(case / f"{n}.csv") for n in ("train", "validation", "test_input")
    )
    model = json.loads((case / "model.json").read_text(encoding="utf-8"))
    (source,) = (i["name"] for i in model["inputs"])
    size, prediction = float(np.std(train[source])), {"time": test["time"]}
    u, u_check, u_test = (t[source][:, None] / size for t in (train, validation, test))
    for o in model["outputs"]:
        name, best = o["name"], (np.inf, np.zeros(len(test["time"])))
        scale = float(np.std(train[name]))
        for degree, lag in ((1, 2), (1, 4), (1, 8), (2, 2), (2, 4), (3, 2)):
            how: dict[str, Any] = {
                "estimator": LeastSquares(),
                "basis_function": Polynomial(degree=degree),
            }
            found = FROLS(ylag=lag, xlag=lag, info_criteria="bic", **how)
            try:
                with np.errstate(all="ignore"):
                    found.fit(X=u, y=train[name][:, None] / scale)
                    run = (
                        scale
                        * found.predict(X=u_check, y=validation[name][:, None] / scale)[
                            :, 0
                        ]
                    )
                    error = float(np.mean((run - validation[name]) ** 2))
                    # a prediction needs its first samples; all masses start at rest
                    start = np.zeros((len(u_test), 1))
                    y = scale * found.predict(X=u_test, y=start)[:, 0]
            except (ValueError, np.linalg.LinAlgError):
                continue
            if np.isfinite(error) and np.isfinite(y).all() and error < best[0]:
                best = error, y
        prediction[name] = best[1]
    return {"effects": []}, prediction


TOOLS: dict[str, Callable[[Path, Path], tuple[Answer, Columns | None]]] = {
    "isd_gym": isd_gym,
    "refit": refit,
    "aic": aic,
    "sindy": sindy,
    "symbolic": symbolic,
    "gp": gp,
    "narx": narx,
}
