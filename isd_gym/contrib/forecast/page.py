"""Page of a plan: smallest identifiable sizes, distances between effects, additional sensors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.files import check_file, write_text
from isd_gym.view._report.plots import (
    as_picture,
    channel_text,
    figure,
    page,
    style,
    unit_text,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .result import EffectForecast, Plan

SHADES = 3.0  # decades of distance between black and white


def write_plan(plan: Plan, path: str | Path) -> Path:
    """Write the page of a plan as one self-contained file.

    Args:
        plan: The plan.
        path: File to write.

    Returns:
        Path of the page.

    Raises:
        InputError: The file cannot be written.
    """
    from .result import STATUS

    check_file(path)
    with style():
        picture = as_picture(
            matrix_figure(plan),
            "matrix",
            "Distances between effects",
            "Matrix of distances between effects and refitted rivals",
            "Each row is an effect at its smallest nameable size (without one, at a twentieth of the typical force). Each "
            "column is a rival, refitted together with the model's parameters, linearised. The shade is the distance in "
            "standard deviations of the noise over the whole record; at 1 or less, effect and rival are indistinguishable. "
            "The diagonal shows the refitted model without any effect. An effect with more parameters is no rival.",
        )
    html = page("plan.html", p=plan, picture=picture, status=STATUS, size_of=size_of)
    write_text(Path(path), html)
    return Path(path)


def matrix_figure(plan: Plan) -> Figure:
    """Return the matrix of distances as an image, with a row and a column for each effect.

    Args:
        plan: The plan.

    Returns:
        The figure.
    """
    names = [channel_text(e.label) for e in plan.effects]
    n = len(names)
    side = min(max(0.17 * n, 1.6), 14.0)
    fig = figure(side + 3.0, side + 2.6)
    ax = fig.add_subplot()
    with np.errstate(divide="ignore", invalid="ignore"):
        shade = np.clip(np.log10(np.maximum(plan.matrix, 1e-9)), 0.0, SHADES)
    image = ax.imshow(shade, cmap="bone", vmin=0.0, vmax=SHADES, interpolation="nearest")
    ax.set_facecolor("#f3d9c9")  # unknown distance
    small = 6.5 if n > 30 else 8
    ax.set_xticks(range(n), names, rotation=90, fontsize=small)
    ax.set_yticks(range(n), names, fontsize=small)
    ax.grid(False)
    ax.set_xlabel("rival, refitted")
    ax.set_ylabel("truth, at its smallest nameable size")
    bar = fig.colorbar(image, ax=ax, shrink=0.5, ticks=range(int(SHADES) + 1))
    bar.ax.set_yticklabels([f"{10**k:g}" for k in range(int(SHADES) + 1)])
    bar.set_label("distance [σ of the noise]")
    return fig


def size_of(e: EffectForecast, amounts: dict[str, Any]) -> str:
    """Return the size of an effect with its shape parameters, such as ``level 12.3 N (shape 2 m)``.

    Args:
        e: The effect.
        amounts: Quantity by parameter.

    Returns:
        Text.
    """
    from isd_gym.diagnosis._verdict.wording import plain_number

    def one(key: str) -> str:
        text = f"{channel_text(key)} {plain_number(amounts[key].value)} {unit_text(amounts[key].unit)}"
        return text.rstrip()

    known = [k for k in amounts if math.isfinite(amounts[k].value)]
    main = ", ".join(one(k) for k in known if k in e.varied)
    shape = ", ".join(one(k) for k in known if k not in e.varied)
    return f"{main} ({shape})" if shape and main else main or shape
