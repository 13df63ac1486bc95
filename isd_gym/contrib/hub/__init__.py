"""A policy as a folder for a model hub: the policy, a card with its results, and a film.

The card is `README.md` with the metadata that the Hugging Face Hub reads (library, tags, `model-index`: task, environment, mean
reward), and the table of the benchmark with this policy in it. A policy that Stable-Baselines3 trained is found by the hub's
filter of that library; `score.json` holds its single episodes, so that anybody can pair their own
with them (`isd-gym card score.json`), and `replay.mp4` is shown beside the card. Nothing is uploaded.
"""

from __future__ import annotations

import datetime
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from isd_gym._common.errors import InputError, plain, shown
from isd_gym._common.files import check_folder, whole_folder
from isd_gym._common.plugins import wing
from isd_gym.agents.policy import JSON_NAME, WEIGHTS_NAME, Policy
from isd_gym.benchmark import _cards as cards
from isd_gym.benchmark._show import film
from isd_gym.benchmark.policies import passive
from isd_gym.benchmark.scoring import Entry, score
from isd_gym.contrib.markdown import markdown
from isd_gym.env.registration import ENVIRONMENTS, EPISODE_STEPS
from isd_gym.physics.network import Network

from .card_table import table as card_table

if TYPE_CHECKING:
    from collections.abc import Callable

CARD, SCORE, FILM = "README.md", "score.json", "replay.mp4"
HUB = ("hub folder", CARD, (CARD, SCORE, FILM, JSON_NAME, WEIGHTS_NAME))
LIBRARY = "stable-baselines3"  # as the hub names it

TEXT = """\
# {title}

A policy ({algorithm}) for `{environment}` of the Python package `isd_gym`. It commands the currents of the motors in a car's hydraulic
electric inerters every 5 ms, from signals that a car can measure{ahead}. The folder holds weights as safetensors and everything
else as JSON. Loading the folder needs no PyTorch and runs no code of it. {library}

```python
import gymnasium
import numpy as np
from isd_gym.agents.policy import Policy  # of isd-gym

policy = Policy.load(".")  # this folder
env = gymnasium.make("{environment}"{options})
observation, info = env.reset(seed=0)
observation, reward, terminated, truncated, info = env.step(np.atleast_1d(policy.act(observation)))
```

## Results

{episodes} roads that the policy was not trained on. The return of an episode is -{steps} J. `{again}` drives them again.

{table}{regret}

## Training

{command}{seconds}.
"""

TRAINED = "Stable-Baselines3 trained the policy. The folder is no archive of that library: load it as below."
REGRET = "\n\nRegret to the causal ceiling, J minus the least J known for causal controllers: {regret:.4f}."


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
    environment = environment_of(policy)
    plant = Network.load(ENVIRONMENTS[environment])
    policy.check(plant)
    name = plain(policy.name, 60).replace("`", "'")
    title = f"{name}-{environment}"
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
        found = score(
            [entry],
            plant,
            reference=passive(plant),
            episodes=episodes,
            ceiling=lambda preview: wing("ceilings").known(plant, preview=preview),
            progress=told,
        ).to_dict()
        found["command"] = _command(policy)
        (place / SCORE).write_text(json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        (place / CARD).write_text(_card(policy, title, found), encoding="utf-8")
    return Path(folder)


def environment_of(policy: Policy) -> str:
    """Return the id of the environment that a policy was made for, by its network; the quarter car without one.

    Args:
        policy: The policy.

    Raises:
        InputError: No environment has that network.
    """
    if policy.model is None:
        return "ISDSuspension-v0"
    for name, network in ENVIRONMENTS.items():
        if network == policy.model.name:
            return name
    raise InputError(
        f"policy {shown(policy.name)} was made for network {shown(policy.model.name)}, which no environment has: "
        f"{', '.join(ENVIRONMENTS.values())}"
    )


def _command(policy: Policy) -> str:
    """Return the command that scores the folder again."""
    network = ENVIRONMENTS[environment_of(policy)]
    car = "" if network == "quarter-car-isd" else f" --network {network}"
    return f"isd-gym score .{car}" + (f" --preview {policy.preview:g}" if policy.preview else "")


def _card(policy: Policy, title: str, found: dict[str, Any]) -> str:
    """Return README.md: the hub's metadata, then the text."""
    ours = next(name for name in found["raw"] if name != "passive")
    environment = environment_of(policy)
    returns = -EPISODE_STEPS * np.array(found["raw"][ours]["cost"])
    row = next(r for r in found["policies"] if r["policy"] == ours)
    training = policy.info.get("training", {})
    algorithm = plain(str(policy.info.get("algorithm", "a network"))).upper()
    try:
        references = cards.load(environment)
        table = card_table(references, cards.match(found, references)["track"], [found])
    except InputError:  # fewer episodes, or another preview, than the references
        today = datetime.date.today().isoformat()
        own = cards.make(environment, [cards.track(found, "own", found["command"])], today)
        table = card_table(own, "own")
    metrics = [
        ("mean_reward", f"{returns.mean():.2f} +/- {returns.std():.2f}"),
        ("cost_j", round(row["cost"]["value"], 4)),
        ("change_of_cost_against_passive", round(row["cost"]["change"], 4)),
    ]
    share = row.get("share_of_causal_gain")  # share of the change of J that the ceiling allows
    regret = cards.regret(row["cost"], row["cost"]["change"] / share) if share else None
    if regret is not None:
        metrics.append(("regret_to_causal_ceiling", round(regret, 4)))
    tags = [environment, "deep-reinforcement-learning", "reinforcement-learning", "isd-gym"]
    converted = str(policy.info.get("origin", "")).startswith("converted from")  # an archive of the library
    library = LIBRARY if converted or LIBRARY in training.get("versions", {}) else None
    if library is not None:
        tags.append(library)
    meta = [
        "---",
        f"library_name: {library or 'isd-gym'}",
        "pipeline_tag: reinforcement-learning",
        "tags:",
        *(f"- {tag}" for tag in tags),
        "model-index:",
        f"- name: {json.dumps(title)}",
        "  results:",
        "  - task:",
        "      type: reinforcement-learning",
        "      name: reinforcement-learning",
        "    dataset:",
        f"      name: {environment}",
        f"      type: {environment}",
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
        title=markdown(title),
        algorithm=markdown(algorithm),
        environment=environment,
        ahead=f" and {policy.preview:g} s of the road ahead" if policy.preview else "",
        options=f', observation="preview", preview={policy.preview:g}' if policy.preview else "",
        episodes=found["episodes"],
        steps=EPISODE_STEPS,
        again=_command(policy),
        library=TRAINED if library else "",
        regret="" if regret is None else REGRET.format(regret=regret),
        table=table,
        command=markdown(str(training.get("command", "not known")), 200, code=True),
        seconds=f", {seconds:.0f} s" if isinstance(seconds, int | float) else "",
    )
    return "\n".join([*meta, "---", "", text])
