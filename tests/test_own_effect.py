"""An element that a user registers is a hypothesis like any other: tried, fitted, named, drawn."""

import math

import numpy as np
import pytest
from builders import oscillator
from program import refused
from scipy.integrate import solve_ivp

from isd_gym import Table, diagnose
from isd_gym.diagnosis import hypotheses
from isd_gym.physics import elements as el

KNOWN = {"spring.stiffness": 0.05, "damper.damping": 0.1}
PARTS = {"mass": 2.0, "stiffness": 800.0, "damping": 8.0}
RIG = oscillator("position displacement mass", base="base", uncertainty=KNOWN, **PARTS)


def _softening(p, d, v, d_last, z, h):
    return p[0] * math.tanh(d / p[1]), z


@pytest.fixture
def registered():
    class Softening(el.Element):
        type = "softening_clip"
        equation = "F = f tanh(d / l)"
        source = "a user's own clip"
        law = staticmethod(_softening)
        force: float = el.parameter("N", 1.0, 100.0)
        length: float = el.parameter("m", 1e-4, 1e-2, open_end=True)

    el.register(Softening)
    yield Softening
    del el.TYPES["softening_clip"]


def record(seed, force, length, seconds=8.0):
    """The true rig, by scipy's integrator."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 4e-3)
    w, phase = 2 * np.pi * rng.uniform(0.5, 6.0, 12), rng.uniform(0, 2 * np.pi, 12)

    def slope(at, state):
        d = state[0] - 0.003 * np.sin(w * at + phase).sum()
        v = state[1] - 0.003 * (w * np.cos(w * at + phase)).sum()
        return [state[1], -(812.0 * d + 7.8 * v + force * math.tanh(d / length)) / 2.0]

    out = solve_ivp(
        slope, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-7, atol=1e-9, max_step=4e-3
    ).y[0]
    base = 0.003 * np.sin(np.outer(t, w) + phase).sum(axis=1)
    return Table(
        t,
        {"base": base, "position": out + 2e-5 * rng.standard_normal(len(t))},
        f"drive {seed}",
    )


def test_it_is_tried_at_every_place(registered):
    tried = {(h.effect, h.where) for h in hypotheses(RIG)}
    assert ("softening_clip", ("mass", "base")) in tried
    assert ("softening_clip", ("mass", "ground")) in tried


def test_its_starts_are_sized_by_the_motion_though_it_says_nothing_of_them(registered):
    d = 0.02 * np.sin(np.linspace(0, 20, 2000))
    motion = el.Motion(d, np.gradient(d, 0.01), d)
    at = el.Setting(RIG, ("mass", "base"), motion, force=16.0)
    starts = registered.starts(at)
    assert len(starts) == 3 and all(s.grows == ("force",) for s in starts)
    for s in starts:
        law = s.values["force"] * np.tanh(d / s.values["length"])
        assert el.rms(law) == pytest.approx(el.PROBE * 16.0, rel=0.05)


@pytest.mark.slow  # the kernel is compiled with it
def test_it_is_named_where_it_is_hidden(registered):
    found = diagnose([record(1, 5.0, 0.004)], RIG, validate=[record(2, 5.0, 0.004)])
    assert found.verdict == "missing_effect", found.summary
    (effect,) = found.effects
    assert (effect.effect, set(effect.between or ())) == (
        "softening_clip",
        {"mass", "base"},
    )
    assert effect.parameters["force"].value == pytest.approx(5.0, rel=0.1)
    assert found.model.element(effect.element).type == "softening_clip"


LAW = """
import math
from isd_gym.physics import elements as el

def law(p, d, v, d_last, z, h):
    return p[0] * math.tanh(d / p[1]), z

class Clip(el.Element):
    type = "filed_clip"
    law = staticmethod(law)
    force: float = el.parameter("N", 1.0, 100.0)
    length: float = el.parameter("m", 1e-4, 1e-2, open_end=True)

el.register(Clip)
"""


def test_a_file_of_the_users_own_registers_elements(tmp_path):
    file = tmp_path / "law.py"
    file.write_text(LAW)
    try:
        el.register_file(file)
        assert any(h.effect == "filed_clip" for h in hypotheses(RIG))
    finally:
        el.TYPES.pop("filed_clip", None)
    (tmp_path / "none.py").write_text("x = 1")
    refused("registers no element", el.register_file, tmp_path / "none.py")
    (tmp_path / "broken.py").write_text("1 / 0")
    refused("ZeroDivisionError", el.register_file, tmp_path / "broken.py")


def test_a_package_offers_elements_through_its_entry_point(monkeypatch):
    class Entry:
        def load(self):
            def offer():
                own = {"type": "offered_damper", "__module__": __name__}
                el.register(type("Offered", (el.LinearDamping,), own))

            return offer

    monkeypatch.setattr(
        "isd_gym.physics.elements._base.entry_points", lambda group: [Entry()]
    )
    el.discover.cache_clear()
    try:
        assert any(h.effect == "offered_damper" for h in hypotheses(RIG))
    finally:
        el.TYPES.pop("offered_damper", None)
        el.discover.cache_clear()
