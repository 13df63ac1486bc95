"""A policy as a folder for a model hub: the policy, a card with its results, and a film.

The card is `README.md` with the metadata of the Hugging Face Hub (`model-index`: task, environment, mean
reward) and the benchmark's table including this policy. `score.json` holds the single episodes for paired
comparisons (`isd-gym card score.json`). `replay.mp4` is shown beside the card. Nothing is uploaded.
"""

from __future__ import annotations

import datetime
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym.benchmark import cards
from isd_gym.errors import InputError, plain
from isd_gym.files import check_folder, whole_folder
from isd_gym.network import Network
from isd_gym.policies import passive
from isd_gym.scoring import Entry, score
from isd_gym.show import film

from .policy import JSON_NAME, WEIGHTS_NAME, Policy

if TYPE_CHECKING:
    from collections.abc import Callable

ENVIRONMENT = "ISDSuspension-v0"
CARD, SCORE, FILM = "README.md", "score.json", "replay.mp4"
HUB = ("hub folder", CARD, (CARD, SCORE, FILM, JSON_NAME, WEIGHTS_NAME))
STEPS = 4000  # control steps of an episode; the return is -J times this number

TEXT = """\
# {title}

A policy ({algorithm}) for `{environment}` of the Python package `isd_gym`: the current of the motor in a car's hydraulic electric inerter,
every 5 ms, from what a car can measure{ahead}. Weights as safetensors, everything else as JSON: loading
it runs nothing of it, and needs numpy alone.

```python
import gymnasium
from agents.policy import Policy  # of isd-gym

policy = Policy.load(".")  # this folder
env = gymnasium.make("{environment}"{options})
observation, info = env.reset(seed=0)
observation, reward, terminated, truncated, info = env.step([policy.act(observation)])
```

## Results

{episodes} roads that it was not trained on; an episode's return is -{steps} J. `isd-gym score .{preview}` makes them again, `isd-gym card score.json` puts
them among the references.

{table}

## Training

`{command}`{seconds}.
"""


def write(
    policy: Policy,
    folder: str | Path,
    *,
    episodes: int = 32,
    seconds: float = 10.0,
    progress: Callable[[str, float], None] | None = None,
) -> Path:
    """Score a policy on the benchmark's roads, film it beside the passive car, and write the folder.

    Args:
        policy: The policy.
        folder: A new or empty folder, or an earlier hub folder.
        episodes: Number of episodes; fewer than the benchmark's 32 cannot be paired.
        seconds: Length of the film [s].
        progress: Called with a task and its finished share.

    Returns:
        The folder.

    Raises:
        InputError: The folder holds other files, or films cannot be made.
    """
    check_folder(folder, *HUB)
    plant = Network.load("quarter-car-isd")
    policy.check(plant)
    name = plain(policy.name, 60).replace("`", "'")
    title = f"{name}-{ENVIRONMENT}"
    entry, told = Entry(name, policy.copy), progress or (lambda task, share: None)
    with whole_folder(folder, *HUB) as place:
        policy.save(place / "policy")
        for part in (JSON_NAME, WEIGHTS_NAME):
            (place / "policy" / part).rename(place / part)
        (place / "policy").rmdir()
        # the film first, since it may lack a library
        film(
            [entry, passive(plant)],
            plant,
            place / FILM,
            seconds=seconds,
            progress=lambda s: told("filming", s),
        )
        found = score([entry], plant, reference=passive(plant), episodes=episodes, progress=told).to_dict()
        command = f"isd-gym score .{_preview(policy)}"
        found["command"] = command
        (place / SCORE).write_text(json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        (place / CARD).write_text(_card(policy, title, found), encoding="utf-8")
    return Path(folder)


def _preview(policy: Policy) -> str:
    return f" --preview {policy.preview:g}" if policy.preview else ""


def _card(policy: Policy, title: str, found: dict[str, Any]) -> str:
    """Return README.md: the hub's metadata, then the text."""
    ours = next(name for name in found["raw"] if name != "passive")
    returns = -STEPS * np.array(found["raw"][ours]["cost"])
    row = next(r for r in found["policies"] if r["policy"] == ours)
    training = policy.info.get("training", {})
    algorithm = plain(str(policy.info.get("algorithm", "a network"))).upper()
    try:
        references = cards.load(ENVIRONMENT)
        table = cards.table(references, cards.match(found, references)["track"], [found])
    except InputError:  # fewer episodes, or another preview, than the references
        today = datetime.date.today().isoformat()
        own = cards.make(ENVIRONMENT, [cards.track(found, "own", found["command"])], today)
        table = cards.table(own, "own")
    metrics = [
        ("mean_reward", f"{returns.mean():.2f} +/- {returns.std():.2f}"),
        ("cost_j", round(row["cost"]["value"], 4)),
        ("change_of_cost_against_passive", round(row["cost"]["change"], 4)),
    ]
    meta = [
        "---",
        "library_name: isd-gym",
        "pipeline_tag: reinforcement-learning",
        "tags:",
        *(f"- {tag}" for tag in (ENVIRONMENT, "deep-reinforcement-learning", "reinforcement-learning")),
        "model-index:",
        f"- name: {json.dumps(title)}",
        "  results:",
        "  - task:",
        "      type: reinforcement-learning",
        "      name: reinforcement-learning",
        "    dataset:",
        f"      name: {ENVIRONMENT}",
        f"      type: {ENVIRONMENT}",
        "    metrics:",
    ]
    for kind, value in metrics:
        meta += [
            f"    - type: {kind}",
            f"      name: {kind}",
            f"      value: {json.dumps(value)}",
            "      verified: false",
        ]
    seconds = training.get("seconds")
    text = TEXT.format(
        title=title,
        algorithm=algorithm,
        environment=ENVIRONMENT,
        ahead=f" and {policy.preview:g} s of the road ahead" if policy.preview else "",
        options=f', observation="preview", preview={policy.preview:g}' if policy.preview else "",
        episodes=found["episodes"],
        steps=STEPS,
        preview=_preview(policy),
        table=table,
        command=plain(str(training.get("command", "not known")), 200).replace("`", "'"),
        seconds=f", {seconds:.0f} s" if isinstance(seconds, int | float) else "",
    )
    return "\n".join([*meta, "---", "", text])
