"""The figures of the documentation, made from the package itself: ``python docs/figures.py [NAME ...]``.

Some minutes in all; names are those of the functions below.
"""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from isd_gym import Network, linearise, simulate
from isd_gym.benchmark.policies import conventional, find
from isd_gym.physics.network import Channel
from isd_gym.physics.road import iso_road, paper_road, road
from isd_gym.view.report.schematic import draw

HERE = Path(__file__).parent / "figures"
# Okabe and Ito: told apart by the colour-blind too
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#777777"
CAR = Network.load("quarter-car-isd")
plt.rcParams.update(
    {
        "svg.fonttype": "none",
        "svg.hashsalt": "isd_gym",  # the same file whenever it is made
        "font.family": "sans-serif",
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#e5e5e5",
        "lines.linewidth": 1.4,
        "legend.frameon": False,
    }
)


def save(figure: plt.Figure, name: str) -> None:
    figure.savefig(
        HERE / f"{name}.svg",
        metadata={"Date": None},
        bbox_inches="tight",
        facecolor="white",
    )
    plt.close(figure)


# ------------------------------------------------------------------------------------------ networks, drawn


def network() -> None:
    """The quarter car, and the rig of the tutorial on rigs, as ``isd-gym networks NAME --draw FILE`` draws them."""
    page = (HERE.parent / "tutorials" / "rig.md").read_text(encoding="utf-8")
    rig = json.loads(page.split('write_text("""')[1].split('""")')[0])
    draw(CAR).save(HERE / "network.svg")
    draw(Network.load(rig)).save(HERE / "carriage.svg")


def law() -> None:
    """The law of the tutorial on effects."""
    fig, ax = plt.subplots(figsize=(5, 2.6))
    d = np.linspace(-60, 60, 400)
    ax.plot(d, 200 * (d / 10) / (1 + (d / 10) ** 2), color=BLUE)
    ax.set(xlabel="travel [mm]", ylabel="force [N]")
    save(fig, "detent")


# ------------------------------------------------------------------------------------------- reports


def reports() -> None:
    """What a score's and a diagnosis' page draw: 32 episodes, and the records of the tutorial on diagnoses."""
    from isd_gym import diagnose, score
    from isd_gym.benchmark.policies import passive
    from isd_gym.view import score_report, write_report

    with tempfile.TemporaryDirectory() as folder:
        names = (
            "passive",
            "isd-passive",
            "skyhook",
            "lqg",
            "mpc",
            "mpc-friction",
            "ppo",
            "sac",
        )
        result = score([find(n, CAR) for n in names], CAR, reference=passive(CAR))
        score_report(result, Path(folder) / "score")
        page = (HERE.parent / "tutorials" / "diagnose.md").read_text(encoding="utf-8")
        blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[:2]
        with contextlib.chdir(folder):
            exec("".join(blocks), {})  # the tutorial's own lines
            found = diagnose(
                ["run1.csv", "run2.csv"], "model.json", validate=["run3.csv"]
            )
        write_report(found, Path(folder) / "found")
        for kind, figure in (
            ("score", "trade_off"),
            ("score", "histories"),
            ("found", "time"),
            ("found", "steps"),
        ):
            shutil.copy(
                Path(folder) / kind / f"{figure}.svg", HERE / f"{kind}_{figure}.svg"
            )


# --------------------------------------------------------------------------------------------- force test


def force_test() -> None:
    fig, (left, right) = plt.subplots(1, 2, figsize=(7.6, 3.0))
    t = np.arange(0, 20, 1e-3)
    triangle = 0.01 * (2 * np.abs(2 * ((0.1 * t + 0.25) % 1) - 1) - 1)
    for name, colour, text in (
        ("force-rig-eq6", RED, "oil in parallel (eq. 6, 8)"),
        ("force-rig", BLUE, "oil in series (here)"),
    ):
        force = simulate(name, t, {"displacement": triangle})["force"]
        left.plot(t, force / 1e3, color=colour, label=text)
    left.set(xlabel="time [s]", ylabel="force [kN]", title="0.1 Hz triangle of ±10 mm")
    left.axhspan(
        -0.5, 0.5, color=GREY, alpha=0.15, lw=0, label="Figure 6: ±0.5 kN square"
    )
    left.legend(fontsize=7.5, loc="upper right")
    left.set_ylim(-8, 17)
    frequency = np.array([0.1, 0.2, 0.4, 0.7, 1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9, 10])
    for name, colour in (("force-rig-eq6", RED), ("force-rig", BLUE)):
        size = []
        for f in frequency:
            tt = np.arange(0, 6 / f, 1 / (400 * f))
            force = simulate(
                name, tt, {"displacement": 0.01 * np.sin(2 * np.pi * f * tt)}, step=5e-4
            )["force"]
            kept = tt >= 3 / f
            size.append(
                2 * np.abs(np.mean(force[kept] * np.exp(-2j * np.pi * f * tt[kept])))
            )
        right.loglog(frequency, np.array(size) / 1e3, "o-", ms=3, color=colour)
    right.loglog(
        frequency,
        95 * (2 * np.pi * frequency) ** 2 * 0.01 / 1e3,
        color=GREY,
        ls="--",
        label="ideal inerter",
    )
    right.set(
        xlabel="frequency [Hz]",
        ylabel="force, fundamental [kN]",
        title="sines of 10 mm",
        ylim=(0.05, 30),
    )
    right.legend(fontsize=7.5)
    fig.tight_layout()
    save(fig, "force_test")


# ---------------------------------------------------------------------------------------------- sticking


def sticking() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(0, 60, 1e-3)
    heights = paper_road().heights(t[-1], rng=rng)
    extra = [
        Channel("rate", "velocity", "m/s", between=("piston", "joint")),
        Channel("friction", "force", "N", element="seal"),
    ]
    out = simulate(CAR, t, {"road": heights, "current": np.zeros_like(t)}, extra=extra)
    fig, (a, b) = plt.subplots(2, 1, figsize=(7.2, 3.2), sharex=True)
    stuck = np.abs(out["rate"]) < 1e-6
    share = stuck.mean()
    moving = np.convolve(
        ~stuck, np.ones(2000), "valid"
    )  # the two seconds with most sliding
    part = slice(int(np.argmax(moving)), int(np.argmax(moving)) + 2000, 4)
    a.plot(t[part], 1e3 * out["rate"][part], color=BLUE)
    a.set(ylabel="device rate\n[mm/s]")
    b.plot(t[part], out["friction"][part], color=RED)
    b.set(ylabel="seal friction\n[N]", xlabel="time [s]", ylim=(-620, 620))
    for y in (-500, 500):
        b.axhline(y, color=GREY, lw=0.8, ls="--")
    for ax in (a, b):
        ax.fill_between(
            t[part],
            0,
            1,
            where=stuck[part],
            transform=ax.get_xaxis_transform(),
            color=GREY,
            alpha=0.13,
            lw=0,
        )
    a.set_title(
        f"no current, the paper's road: the device sticks (grey) {100 * share:.0f} % of a minute; its liveliest 2 s"
    )
    fig.tight_layout()
    save(fig, "sticking")


# -------------------------------------------------------------------------------------------------- roads


def roads() -> None:
    from scipy.signal import welch

    fig, ax = plt.subplots(figsize=(5.6, 3.2))
    n = np.logspace(-2, 1, 100)
    for letter, colour in zip("ABCD", (GREEN, BLUE, ORANGE, RED), strict=True):
        ax.loglog(n, iso_road(letter).psd(n), color=colour, label=f"class {letter}")
    rng, step = np.random.default_rng(0), 1e-3
    z = np.concatenate(
        [paper_road().heights(100.0, speed=20.0, step=step, rng=rng) for _ in range(8)]
    )
    z = z.reshape(8, -1)
    f, s = welch(z, 1 / (20.0 * step), nperseg=20000, axis=1)
    keep = np.unique(np.searchsorted(f, np.logspace(-1.7, 0.99, 150)))
    ax.loglog(
        f[keep],
        s.mean(axis=0)[keep],
        color=GREY,
        lw=0.8,
        alpha=0.9,
        label="paper, 8 drives of 2 km",
    )
    ax.set(
        xlabel="spatial frequency [cycle/m]",
        ylabel="PSD of height [m³]",
        xlim=(0.01, 10),
    )
    ax.legend(fontsize=7.5)
    save(fig, "roads")


# --------------------------------------------------------------------------------------------- responses


def response() -> None:
    fig, ax = plt.subplots(figsize=(5.6, 3.2))
    f = np.logspace(-0.5, 1.5, 300)
    kinds = (
        ("conventional: k ∥ c", conventional(CAR), {}, GREY),
        (
            "ISD, friction 500 N sliding gently (equation 9, 0.05 m/s)",
            CAR,
            {"seal": 4 * 500 / (np.pi * 0.05)},
            RED,
        ),
        (
            "ISD without friction",
            CAR.with_parameters({"seal.level": 0.0}),
            {"seal": 0.0},
            BLUE,
        ),
    )
    for label, net, damping, colour in kinds:
        ss = linearise(net, damping=damping)
        h = ss.response(f)[
            :, ss.outputs.index("body_acceleration"), ss.inputs.index("road")
        ]
        ax.loglog(f, np.abs(h) / (2 * np.pi * f), color=colour, label=label)
    ax.set(
        xlabel="frequency [Hz]",
        ylabel="body acceleration / road velocity [1/s]",
        xlim=(f[0], f[-1]),
    )
    ax.legend(fontsize=7.5)
    save(fig, "response")


def projection() -> None:
    """One step of the projection: the force that stops the sliding, cut off at the level."""
    fig, ax = plt.subplots(figsize=(3.6, 2.6))
    s = np.linspace(-2, 2, 200)
    ax.plot(s, np.clip(s, -1, 1), color=BLUE)
    ax.set(
        xlabel="force that would stop it / level",
        ylabel="friction force / level",
        xticks=(-2, -1, 0, 1, 2),
        yticks=(-1, 0, 1),
    )
    ax.text(0, -0.75, "sticks", ha="center", color=GREY)
    ax.text(1.5, 0.65, "slides", ha="center", color=GREY)
    ax.text(-1.5, -0.8, "slides", ha="center", color=GREY)
    save(fig, "projection")


def show() -> None:
    """Frames of ``isd-gym show``: two quarter cars after eight seconds, the picture of the README; a half and a full car on a bump."""
    from isd_gym.benchmark.show import snapshots
    from isd_gym.view.rendering import Renderer

    frames: dict[str, tuple[tuple[str, ...], str, float, tuple[int, int], str]] = {
        "show": (("mpc", "passive"), "quarter-car-isd", 8.0, (1000, 560), "paper"),
        "show-half-car": (("mpc-friction",), "half-car-isd", 1.1, (960, 560), "C+bump"),
        "show-full-car": (
            ("mpc-friction",),
            "full-car-isd",
            1.1,
            (960, 560),
            "C+bump-right",
        ),
    }
    for name, (policies, network, seconds, (width, height), ground) in frames.items():
        drawn = Renderer("rgb_array", width=width, height=height, cars=len(policies))
        plant = Network.load(network)
        entries = [find(policy, plant) for policy in policies]
        for k, shots in enumerate(
            snapshots(entries, plant, seconds=seconds, road=ground)
        ):
            if k % 4 == 0:
                frame = drawn.draw(*shots)
        drawn.close()
        Image.fromarray(frame).save(HERE / f"{name}.png", optimize=True)


#: film -> policies, network and what else `isd-gym show` is told; the gallery says the same
FILMS: dict[str, tuple[tuple[str, ...], str, dict[str, Any]]] = {
    "pair-bump": (
        ("mpc-friction", "lqg"),
        "quarter-car-isd",
        {"road": "C+bump", "seconds": 4.0},
    ),
    "preview": (
        ("mpc-friction-preview", "mpc-friction"),
        "quarter-car-isd",
        {"road": "C+pothole", "seconds": 4.0, "preview": 0.2},
    ),
    "half-car-bump": (
        ("mpc-friction", "passive"),
        "half-car-isd",
        {"road": "C+bump", "seconds": 3.0},
    ),
    "full-car-bump": (
        ("mpc-friction",),
        "full-car-isd",
        {"road": "C+bump-right", "seconds": 3.0},
    ),
}


def films() -> None:
    """Cars alone or side by side, small enough for a repository."""
    import subprocess

    from imageio_ffmpeg import get_ffmpeg_exe

    from isd_gym.benchmark.show import film

    with tempfile.TemporaryDirectory() as folder:
        for name, (policies, network, drive) in FILMS.items():
            raw = Path(folder) / f"{name}.mp4"
            plant, drive = Network.load(network), dict(drive)
            ahead = {"preview": drive.pop("preview")} if "preview" in drive else {}
            film(
                [find(policy, plant, **ahead) for policy in policies],
                plant,
                raw,
                **drive,
            )
            small = [
                "-vf",
                "scale=800:-2",
                "-r",
                "25",
                "-crf",
                "33",
                "-preset",
                "veryslow",
                "-an",
            ]
            args = [
                get_ffmpeg_exe(),
                "-y",
                "-loglevel",
                "error",
                "-i",
                str(raw),
                *small,
                str(HERE / f"{name}.mp4"),
            ]
            subprocess.run(args, check=True)


def preview() -> None:
    """Change of J over the seconds of road ahead, of the references of the benchmark's card, and the ceilings."""
    from isd_gym import Network
    from isd_gym.benchmark import cards
    from isd_gym.benchmark.ceilings import ceiling
    from isd_gym.physics.road import road

    card = cards.load("ISDSuspension-v0")
    families = {"LQG": "lqg", "friction-aware MPC": "mpc-friction", "PPO": "ppo"}
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in families}
    bounds = []
    for track in card["tracks"]:
        rows = {
            r["policy"]: r["cost"]["change"]
            for r in cards.ranking(card, track["track"])
        }
        ahead = max(p["preview"] for p in track["policies"].values())
        for name, stem in families.items():
            for policy in (stem, f"{stem}-preview", f"{stem}-preview-{ahead:g}"):
                if policy in rows and (ahead == 0) == (policy == stem):
                    found[name].append((ahead, 100 * rows[policy]))
        plant = Network.load(track["network"])
        bound = ceiling(
            plant,
            road(track["road"]),
            track["speed"]["value"],
            track["duration"]["value"],
            preview=ahead,
        )
        if bound:
            bounds.append((ahead, 100 * bound.change))
    figure, axes = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
    for (name, points), mark in zip(found.items(), "s^o", strict=True):
        axes.plot(*zip(*sorted(points), strict=True), marker=mark, label=name)
    axes.plot(
        *zip(*sorted(bounds), strict=True),
        color="0.4",
        linestyle="--",
        label="ceiling (searched)",
    )
    axes.set(xlabel="road ahead [s]", ylabel="J against the passive car [%]")
    axes.legend()
    save(figure, "preview")


def yardsticks() -> None:
    """The completed laws of the official benchmarks."""
    found = json.loads(
        (HERE.parents[1] / "benchmarks" / "yardsticks.json").read_text(encoding="utf-8")
    )
    fig, axes = plt.subplots(1, 2, figsize=(7, 2.6), layout="constrained")
    spring, friction = found["silverbox"]["law"], found["emps"]["law"]
    x, force = np.array(spring["axis"]), np.array(spring["force"])
    axes[0].plot(x, force, color=BLUE, label="completed")
    linear = found["silverbox"]["parameters"]["spring.stiffness"]
    axes[0].plot(x, linear * x, color=GREY, ls="--", label="linear part")
    axes[0].set(xlabel=spring["label"], ylabel="spring force", title="Silverbox")
    axes[0].legend()
    axes[1].plot(
        friction["axis"], friction["force"], color=BLUE, label="from force to motion"
    )
    other = found["emps-inverse"]["law"]
    axes[1].plot(
        other["axis"],
        other["force"],
        color=ORANGE,
        ls="--",
        label="from motion to force",
    )
    axes[1].set(xlabel=friction["label"], ylabel="friction [N]", title="EMPS")
    axes[1].legend()
    save(fig, "yardsticks")


def see_through(file: Path) -> None:
    """Make the white ground of a drawing transparent; the style sheet turns its lightness round in the dark.

    Args:
        file: SVG or PNG on white, changed in place. The same again changes nothing.
    """
    if file.suffix == ".svg":
        text = file.read_text(encoding="utf-8")
        text = text.replace('style="fill: #ffffff"', 'style="fill: none"')
        text = re.sub(r'<rect width="\d+" height="\d+" fill="#fff"/>', "", text)
        file.write_text(text, encoding="utf-8")
        return
    picture = Image.open(file).convert("RGBA")
    if picture.getextrema()[3][0] < 255:
        return
    rgb = np.asarray(picture, float)[..., :3] / 255
    alpha = 1 - rgb.min(
        axis=2, keepdims=True
    )  # the least ink that gives this colour on white
    ink = np.where(alpha > 0, 1 - (1 - rgb) / np.maximum(alpha, 1e-3), 0.0)
    pixels = np.concatenate([ink, alpha], axis=2).clip(0, 1)
    drawn = Image.fromarray(np.rint(255 * pixels).astype(np.uint8))  # RGBA
    drawn.quantize(256, method=Image.Quantize.FASTOCTREE).save(file, optimize=True)


if __name__ == "__main__":
    HERE.mkdir(exist_ok=True)
    road("paper")
    every = (
        network,
        law,
        force_test,
        sticking,
        roads,
        response,
        projection,
        show,
        films,
        reports,
        preview,
        yardsticks,
    )
    for make in every:
        if not sys.argv[1:] or make.__name__ in sys.argv[1:]:
            make()
            print(make.__name__)
    for figure in (*HERE.glob("*.svg"), *HERE.glob("*.png")):
        if not figure.name.startswith("show"):  # a scene, not a drawing
            see_through(figure)
