"""`isd-gym convert`: a policy of Stable-Baselines3 as a policy folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ._options import TrainedOption, option


def command(
    archive: Annotated[
        Path,
        typer.Argument(
            help="A .zip saved by Stable-Baselines3, or a policy folder to check and copy."
        ),
    ],
    out: Annotated[Path, option("--out DIR", "Folder for the policy.")],
    normalize: Annotated[
        Path | None,
        option(
            "--normalize FILE",
            "The saved VecNormalize of the archive. Default: <name>_vecnormalize.pkl or vecnormalize.pkl beside it.",
        ),
    ] = None,
    trained_with: TrainedOption = None,
    network: Annotated[
        str, option("--network", "The network it was trained on.")
    ] = "quarter-car-isd",
) -> None:
    """Turn a Stable-Baselines3 PPO, A2C, SAC, TD3, DDPG or TQC archive into a policy folder.

    Example: isd-gym convert model.zip --normalize norm.pkl --out my-policy
    """
    from ..agents._archives import convert, trained_options
    from ..agents.policy import Policy

    if archive.suffix.lower() == ".zip":
        given: dict[str, Any] = dict(
            trained_options(trained_with) if trained_with else {}
        )
        if normalize is not None:
            given["normalize"] = normalize
        policy = convert(archive, network=network, **given)
        if "normalisation" in policy.info and "normalize" not in given:
            typer.echo(
                f"{archive}: normalised by '{policy.info['normalisation']}' beside it",
                err=True,
            )
    else:
        policy = Policy.load(archive)
    typer.echo(f"policy in '{policy.save(out)}'")
