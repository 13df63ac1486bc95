"""Figure 10, Tables 7 and 8: the controllers on the road."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..._common.seeds import road_name
from ...benchmark.ceilings import reachable as known_optimum
from ...benchmark.scoring import PAPER, Score
from ...env.task import CONTROL_STEP
from ...physics.cost import StageCost
from ...view.report.plots import LOOKS, Look, density, figure, percent
from ...view.report.plots import Picture as PagePicture
from .driving import DRIVEN, drive_all, own_cost, score_rows, triple
from .study import PRINTED, SERIES, Claim, Section, Study, Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


#: columns of the tables: figure, factor to the printed unit, decimals
MEASURES = (
    ("body_acceleration", 1.0, 3),
    ("suspension_travel", 1e3, 2),
    ("tyre_load", 1.0, 0),
)


def simulation(study: Study) -> Section:
    """Recompute Figure 10 and Table 7 beside Table 8, for the series network and the printed equation.

    Args:
        study: Shared results.

    Returns:
        The section.
    """
    episodes, duration = (2, 10.0) if study.quick else (32, 20.0)
    series = drive_all(study, SERIES, list(DRIVEN), episodes, duration)
    printed = drive_all(
        study, PRINTED, ["isd-passive", "lqg", "mpc"], 2 if study.quick else 8, duration
    )
    rows = _paper_rows() + score_rows(series, "")
    rows += [
        r
        for r in score_rows(printed, ", printed eq. (8)")
        if not r[0].startswith("passive")
    ]
    known = known_optimum(SERIES, episodes=episodes, duration=duration)
    if known is not None:
        rows.append(_optimum_row(study, series, known))
    study.figures["table_7"] = {
        "series": series.to_dict(),
        "printed": printed.to_dict(),
    }
    active = [
        r
        for r in series.policies
        if r["policy"] not in ("passive", "isd-passive", "mpc-paper")
    ]
    best = min(
        (r for r in active if r["policy"].startswith("mpc")),
        key=lambda r: r["cost"]["value"],
    )
    name = best["policy"]
    low, high = _claim_of_records(study, series, best)
    _claim_of_bench(study, {r["policy"]: triple(r) for r in active})
    _full_state(study, episodes, duration)
    _sticking(study, series)
    pictures = [_histories(study, series, name), _spectra(study, series, name)]
    text = [
        f"{episodes} episodes of {duration:g} s on the paper's road, the same for all; changes are paired, against the conventional passive car. "
        f"The best predictive controller here, {name}, sees measured signals only and keeps every limit of Table 5. "
        f"Cut into records of 10 s, its change of acceleration scatters from {percent(low[0])} to {percent(high[0])} (95 %), of travel from {percent(low[1])} to "
        f"{percent(high[1])}, of tyre load from {percent(low[2])} to {percent(high[2])}: a single short record says little."
    ]
    if known is not None:
        least, reached = known["lower"].mean(), known["value"].mean()
        share = (own_cost(series) - reached) / (own_cost(series) - least)
        text.append(
            "The clairvoyant optimum knows the road of the whole episode and keeps all limits in the real network: what it reaches is an upper bound of the least cost. "
            f"Proven is only that no currents cost less than {least:.3f} in the car without its end stops, where friction may be any force "
            f"within its level. So what is reached is at least {percent(share, 0, sign=False)} of the conceivable gain."
        )
    table = Table(
        "RMS and change against passive",
        (
            "",
            "cost J",
            "acceleration [m/s²]",
            "travel [mm]",
            "tyre load [N]",
            "of the reachable gain",
        ),
        rows,
        "Quick run: few and short episodes."
        if study.quick
        else "Printed eq. (8): 8 episodes; controller and plant both as printed, with f before sgn.",
    )
    return Section("The car (Figure 10, Tables 7 and 8)", text, [table], pictures)


def _paper_rows() -> list[Sequence[str]]:
    """Return the rows of Tables 7 and 8 as printed."""
    rows: list[Sequence[str]] = []
    for name, (before, after) in PAPER.items():
        table = name.split(" (")[0]
        (a0, l0, t0), (a1, l1, t1) = before, after
        changes = [percent(q / p - 1) for p, q in zip(before, after, strict=True)]
        rows.append(
            (f"{table}: passive", "–", f"{a0:.4f}", f"{1e3 * l0:.2f}", f"{t0:.1f}", "–")
        )
        texts = (f"{a1:.4f}", f"{1e3 * l1:.2f}", f"{t1:.1f}")
        cells = (
            f"{text}\u00a0({change})"
            for text, change in zip(texts, changes, strict=True)
        )
        rows.append((f"{table}: active", "–", *cells, "–"))
    return rows


def _optimum_row(
    study: Study, series: Score, known: Mapping[str, np.ndarray]
) -> Sequence[str]:
    """Return the row of the clairvoyant optimum, and store its figures."""
    run = next(iter(series.runs.values()))
    own = [float(np.sqrt(np.mean(getattr(run, key) ** 2))) for key, _, _ in MEASURES]
    point = [float(np.sqrt(np.mean(known[key] ** 2))) for key, _, _ in MEASURES]
    change = [v / o - 1 for v, o in zip(point, own, strict=True)]
    study.figures["clairvoyant"] = {
        "cost": float(known["value"].mean()),
        "lower": float(known["lower"].mean()),
        "rms": point,
        "change": change,
    }
    cells = [
        f"{value * scale:.{digits}f}\u00a0({percent(moved)})"
        for value, moved, (_, scale, digits) in zip(
            point, change, MEASURES, strict=True
        )
    ]
    return ("clairvoyant optimum", f"{known['value'].mean():.3f}", *cells, "100 %")


def _claim_of_records(
    study: Study, series: Score, best: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """State how Table 7 compares with the best predictive controller, and return the 95 % range of its changes in records of 10 s."""
    name, change = best["policy"], triple(best)
    run = next(iter(series.runs.values()))
    pieces = round(10.0 / CONTROL_STEP)
    strays = []
    for key, _, _ in MEASURES:
        a, b = getattr(series.runs[name], key), getattr(run, key)
        parts = [
            np.sqrt(np.mean(x.T.reshape(-1, min(pieces, len(x))) ** 2, axis=1))
            for x in (a, b)
        ]
        strays.append(parts[0] / parts[1] - 1)
    low, high = (np.quantile(np.array(strays), q, axis=1) for q in (0.025, 0.975))
    study.figures["ten_seconds"] = {
        "policy": name,
        "low": low.tolist(),
        "high": high.tolist(),
        "pieces": len(strays[0]),
    }
    lucky = np.all(np.array(strays) <= np.array(_paper_changes(0))[:, None], axis=0)
    count = int(lucky.sum())
    meet = f"{count} of {len(lucky)} records {'meets' if count == 1 else 'meet'}"
    study.claims.append(
        Claim(
            "Section 4.3",
            "predictive control lowers all three of acceleration, travel and tyre load",
            f"{name}, from measured signals, under every limit: {percent(change[0])}, {percent(change[1])}, {percent(change[2])}; in single records of "
            f"10 s from {percent(low[0])} to {percent(high[0])} in acceleration; {meet} Table 7 in all three",
            "holds in direction for acceleration and travel"
            + ("" if change[2] > 0 else " and tyre load")
            + ", not in size",
        )
    )
    return low, high


def _paper_changes(table: int) -> list[float]:
    """Return the changes of acceleration, travel and tyre load in Table 7 (0) or Table 8 (1)."""
    before, after = list(PAPER.values())[table]
    return [q / p - 1 for p, q in zip(before, after, strict=True)]


def _claim_of_bench(study: Study, triples: Mapping[str, Sequence[float]]) -> None:
    """State which policies reach Table 8; changes by policy."""
    wanted = _paper_changes(1)
    reached = any(
        all(c <= w + 0.002 for c, w in zip(t, wanted, strict=True))
        for t in triples.values()
    )
    told = "; ".join(
        f"{name} reaches {', '.join(map(percent, t))}" for name, t in triples.items()
    )
    study.claims.append(
        Claim(
            "Table 8",
            f"{', '.join(map(percent, wanted))} on the bench",
            f"inside the causal bound; in simulation {told}",
            "plausible, and reached here"
            if reached
            else "plausible: not excluded by any bound",
        )
    )


def _full_state(study: Study, episodes: int, duration: float) -> None:
    """Drive the regulator that sees the whole state, and store its evidence."""
    found = drive_all(study, SERIES, ["lqr-full"], episodes, duration)
    (row,) = (r for r in found.policies if r["policy"] == "lqr-full")
    change = triple(row)
    study.figures["full_state"] = {"change": change, "cost": row["cost"]}
    study.evidence.append(
        (
            "full state under every limit",
            f"LQR with friction compensation, every limit, seeing the state: {', '.join(map(percent, change))}, cost {percent(row['cost']['change'])}",
            "the bar for a controller that sees only what is measured",
        )
    )


def _sticking(study: Study, series: Score) -> None:
    """Store how often the device sticks without current."""
    share = float(np.mean(np.abs(series.runs["isd-passive"].device_travel_rate) < 1e-6))
    study.figures["sticking"] = share
    study.evidence.append(
        (
            "friction in eq. (8)",
            f"with f = 500 N the device of the ISD car without current sticks {percent(share, 0, sign=False)} of the time",
            "f = 500 N from eq. (6); the passive ISD is then a spring and damper in parallel",
        )
    )


SIGNALS = (
    ("body_acceleration", "body acceleration", "m/s²", 1.0),
    ("suspension_travel", "suspension travel", "mm", 1e3),
    ("tyre_load", "dynamic tyre load", "N", 1.0),
)


def _shown(found: Score, name: str) -> list[tuple[str, Look]]:
    """Return the reference, the car without current and a policy, with their styles."""
    return [
        (next(iter(found.runs)), LOOKS[0]),
        ("isd-passive", LOOKS[5]),
        (name, LOOKS[1]),
    ]


def _histories(study: Study, found: Score, name: str) -> PagePicture:
    fig = figure(7.2, 4.8)
    axes = fig.subplots(3, 1, sharex=True)
    first = next(iter(found.runs.values()))
    cost = first.cost(StageCost())
    episode = int(np.argsort(cost)[len(cost) // 2])
    count = min(round(5.0 / CONTROL_STEP), len(first.tyre_load))
    begin = (len(first.tyre_load) - count) // 2
    time = (begin + np.arange(count)) * CONTROL_STEP
    for ax, (key, title, unit, scale) in zip(axes, SIGNALS, strict=True):
        for who, look in _shown(found, name):
            values = (
                getattr(found.runs[who], key)[begin : begin + count, episode] * scale
            )
            ax.plot(
                time,
                values,
                color=look.colour,
                ls=look.line,
                lw=0.9 * look.width,
                label=who,
            )
        ax.set_ylabel(f"{title}\n[{unit}]")
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(time[0], time[-1])
    fig.align_ylabels(axes)
    handles, labels = axes[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside upper left", ncols=4)
    return study.picture(
        fig, "figure_10_time", "Figure 10, time", "Three signals over five seconds",
        f"Figure 10 anew, in time: five seconds of a middling episode ({road_name(found.seed, episode)}).",
    )  # fmt: skip


def _spectra(study: Study, found: Score, name: str) -> PagePicture:
    from matplotlib.ticker import LogLocator

    fig = figure(7.6, 3.0)
    axes = fig.subplots(1, 3)
    for ax, (key, title, unit, scale) in zip(axes, SIGNALS, strict=True):
        for who, look in _shown(found, name):
            f, p = density(scale * getattr(found.runs[who], key), CONTROL_STEP)
            keep = (f >= 0.4) & (f <= 30.0)
            ax.loglog(
                f[keep],
                p[keep],
                color=look.colour,
                ls=look.line,
                lw=look.width,
                label=who,
            )
        ax.set_title(title)
        ax.set_ylabel(f"({unit})²/Hz" if "/" in unit else f"{unit}²/Hz")
        ax.set_xlabel("frequency [Hz]")
        ax.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
        ax.minorticks_off()
        low, high = ax.get_ylim()
        if high / low < 100:  # decades alone would leave one or two marks
            ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            ax.yaxis.set_major_formatter(lambda v, _: f"{v:g}")
    handles, labels = axes[0].get_legend_handles_labels()
    fig.legend(handles, labels, loc="outside upper left", ncols=4)
    return study.picture(
        fig, "figure_10_psd", "Figure 10, frequency", "Power spectral densities of three signals",
        "Figure 10 anew, in frequency: one-sided power spectral densities, averaged over all episodes. As in the paper, the gain is at the body's resonance.",
    )  # fmt: skip
