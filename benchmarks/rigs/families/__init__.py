"""Families of rigs for the hidden suite: what a diagnosis meets on benches that nobody here built.

`make_case(kind, seed)` draws a rig of a family (`kind` is "family.what"), hides an effect in it, two, none, or one that
the library does not have, and returns the records, the model as its owner believes it, and the truth.

- `draw`: scales (a gram to five tonnes, 50 Hz to 5 kHz, 300 to 20,000 samples) and signals;
- `effects`: what is hidden, in proportion to the motion where it sits;
- `rigs`, `half_car`: the families, and which kinds each has; `unseen`: those that are kept aside, and are run once;
- `plant`: an integrator of their own, Runge-Kutta in small steps, that shares nothing with the project's kernel;
- `bench`: a rig, one simulation of it, and the best fit without what is hidden;
- `case`: the size of the effect, nuisances, noise, the owner's errors.

How large an effect is, is not drawn in newtons: it is the share of a channel's deviation that is left when the model
without the effect is fitted to the noiseless truth within its stated uncertainty (`Case.irreducible`), 8 to 50 % and at
least twice the noise; so what is hidden can be seen, and can't be had by moving parameters. Besides, every rig has one to
three nuisances, each below 1.5 % of the motion.
"""

from __future__ import annotations

from ..case import Case
from . import case as _case
from .case import Family
from .rigs import FAMILIES
from .unseen import UNSEEN

KINDS: list[str] = [
    f"{family}.{kind}" for family, f in FAMILIES.items() for kind in f.kinds
]
"""Every kind to work on."""
UNSEEN_KINDS: list[str] = [
    f"{family}.{kind}" for family, f in UNSEEN.items() for kind in f.kinds
]
"""Every kind that is kept aside."""


def make_case(kind: str, seed: int) -> Case:
    """One case; everything is drawn from `kind` and `seed`."""
    return _case.make_case({**FAMILIES, **UNSEEN}[kind.split(".")[0]], kind, seed)


__all__ = ["FAMILIES", "KINDS", "UNSEEN_KINDS", "Case", "Family", "make_case"]
