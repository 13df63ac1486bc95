"""The paper's car in simulation: Tables 6 to 8, and Figure 10."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ...benchmark.lq_bounds import best_acceleration
from ...benchmark.lq_bounds import reference as passive_rms
from ...benchmark.scoring import PAPER, Score, score
from ...env.task import CONTROL_STEP
from ...physics.cost import StageCost
from ...physics.road import PRINTED_KAPPA, paper_road
from ...view.report.plots import LOOKS, density, figure, number, percent
from .study import Study

POLICIES = ("isd-passive", "lqg", "mpc-paper", "mpc", "mpc-friction")
#: signals of the tables: name, unit, factor to the unit, decimals
SIGNALS = (
    ("body_acceleration", "m/s²", 1.0, 3),
    ("suspension_travel", "mm", 1e3, 2),
    ("tyre_load", "N", 1.0, 0),
)


def road_level(study: Study) -> None:
    """Compare the passive car on the printed road and on a smoother road with Table 7."""
    printed = passive_rms(road=paper_road(PRINTED_KAPPA))
    used = passive_rms()
    study.figures["passive"] = {"printed": printed.tolist(), "used": used.tolist()}
    (paper, _), _ = PAPER.values()
    study.claim(
        "Table 6",
        "road roughness 5·10⁻⁶ m³/cycle",
        f"passive car {number(printed[0])} m/s²; at a tenth of it {number(used[0])} m/s² (Table 7: {paper[0]}) "
        f"and a travel of {number(1e3 * used[1])} mm ({1e3 * paper[1]:.1f})",
        "ten times too rough",
    )


def drive(study: Study) -> None:
    """Drive the controllers for Tables 7 and 8 and Figure 10, beside the causal bound."""
    found = score(
        POLICIES,
        episodes=2 if study.quick else 32,
        duration=10.0 if study.quick else 20.0,
        progress=study.progress,
    )
    study.figures["score"] = found.to_dict()
    controllers = [r for r in found.policies if r["policy"].startswith("mpc")]
    best = min(controllers, key=lambda r: r["cost"]["value"])
    for name, (before, after) in PAPER.items():
        _paper_row(study, f"{name}, passive", before, before)
        _paper_row(study, f"{name}, active", after, before)
    for row in found.policies:
        cells = [
            _cell(row[f"{name}_rms"], scale, digits)
            for name, _, scale, digits in SIGNALS
        ]
        study.cars.append([row["policy"], f"{row['cost']['value']:.3f}", *cells])
    changes = {name: best[f"{name}_rms"]["change"] for name, *_ in SIGNALS}
    reached = f"{best['policy']}: {_changes_text(changes.values())}"
    lower = [name.replace("_", " ") for name, change in changes.items() if change < 0]
    study.claim(
        "Section 4.3",
        "predictive control lowers acceleration, travel and tyre load",
        reached,
        f"holds for {' and '.join(lower) or 'none'}",
    )
    for name, (before, after) in PAPER.items():
        printed = [a / b - 1 for a, b in zip(after, before, strict=True)]
        bound = best_acceleration(*printed[1:]).acceleration_change
        study.figures[f"bound of {name}"] = {"printed": printed, "bound": bound}
        study.claim(
            name,
            _changes_text(printed),
            f"no causal controller is better than {percent(bound)} at that travel and tyre load; {reached}",
            "possible" if bound <= printed[0] else "not possible on average",
        )
    _draw(study, found, best["policy"])


def _changes_text(changes: Iterable[float]) -> str:
    return ", ".join(map(percent, changes))


def _paper_row(study: Study, name: str, values: Any, passive: Any) -> None:
    """Add a row of Table 7 or 8 as printed."""
    cells = []
    for value, ground, signal in zip(values, passive, SIGNALS, strict=True):
        quantity = {"value": value, "change": value / ground - 1}
        cells.append(_cell(quantity, signal[2], signal[3]))
    study.cars.append([name, "–", *cells])


def _cell(quantity: dict[str, float], scale: float, digits: int) -> str:
    value = f"{scale * quantity['value']:.{digits}f}"
    return f"{value}\u00a0({percent(quantity.get('change'))})"


def _draw(study: Study, found: Score, policy: str) -> None:
    """Draw Figure 10: five seconds of a middling episode, and spectra over all episodes."""
    runs = found.runs
    looks = dict(zip(("passive", "isd-passive", policy), LOOKS, strict=False))
    cost = runs["passive"].cost(StageCost())
    episode = int(np.argsort(cost)[len(cost) // 2])
    shown = slice(0, round(5.0 / CONTROL_STEP))
    histories = figure(7.2, 4.8)
    spectra = figure(7.6, 3.0)
    rows = histories.subplots(3, 1, sharex=True)
    columns = spectra.subplots(1, 3)
    for above, beside, signal in zip(rows, columns, SIGNALS, strict=True):
        name, unit, scale, _ = signal
        for who, look in looks.items():
            how = {"color": look.colour, "ls": look.line, "lw": 1.0, "label": who}
            x = scale * getattr(runs[who], name)
            time = CONTROL_STEP * np.arange(len(x))
            above.plot(time[shown], x[shown, episode], **how)
            f, power = density(x, CONTROL_STEP)
            keep = (f >= 0.4) & (f <= 30.0)
            beside.loglog(f[keep], power[keep], **how)
        title = name.replace("_", " ")
        above.set_ylabel(f"{title}\n[{unit}]")
        beside.set(title=title, xlabel="frequency [Hz]", ylabel=f"({unit})²/Hz")
    rows[-1].set_xlabel("time [s]")
    for fig, ax in (histories, rows[0]), (spectra, columns[0]):
        fig.legend(*ax.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    study.picture(
        histories,
        "figure_10_time",
        "Figure 10 in time: three signals over five seconds",
        "The episode has the median cost of the passive car.",
    )
    study.picture(
        spectra,
        "figure_10_psd",
        "Figure 10 in frequency: power spectral densities of three signals",
        "One-sided densities, averaged over all episodes. As in the paper, the gain is at the body's resonance.",
    )
