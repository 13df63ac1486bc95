"""`isd-gym convert`: a policy of Stable-Baselines3 as a policy folder, and policies as ONNX, plain C or a folder for a hub."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from isd_gym._commands._options import TrainedOption, option
from isd_gym._common.errors import InputError
from isd_gym._common.plugins import wing


def command(
    archive: Annotated[
        Path,
        typer.Argument(
            help="A .zip saved by Stable-Baselines3, or a policy folder for --onnx, --c and --hub, or mpc-friction for --c."
        ),
    ],
    out: Annotated[Path | None, option("--out DIR", "Folder for the policy.")] = None,
    normalize: Annotated[
        Path | None,
        option(
            "--normalize FILE",
            "The saved VecNormalize of the archive. Default: <name>_vecnormalize.pkl or vecnormalize.pkl beside it.",
        ),
    ] = None,
    trained_with: TrainedOption = None,
    network: Annotated[str, option("--network", "The network it was trained on.")] = "quarter-car-isd",
    onnx: Annotated[Path | None, option("--onnx FILE", "Write an ONNX file.")] = None,
    plain_c: Annotated[Path | None, option("--c DIR", "Write it as plain C, a header and a source.")] = None,
    hub: Annotated[
        Path | None, option("--hub DIR", "Write a folder for a model hub: policy, card with results, film.")
    ] = None,
) -> None:
    """Turn a Stable-Baselines3 PPO, A2C, SAC, TD3, DDPG or TQC archive into a policy folder, or a policy into ONNX, plain C or a
    folder for a hub.

    The controllers mpc-friction, mpc-friction-preview and mpc-robust, with --network as their model, can be
    written as C, too.

    Example: isd-gym convert model.zip --normalize norm.pkl --out my-policy
    """
    from isd_gym.agents.policy import Policy

    from .archives import convert, trained_options

    if out is None and onnx is None and plain_c is None and hub is None:
        raise InputError("nothing to write: give --out DIR, --onnx FILE, --c DIR or --hub DIR")
    if not os.path.exists(archive) and _controller(str(archive), out or hub, onnx, plain_c, network):
        return
    if archive.suffix.lower() == ".zip":
        given: dict[str, Any] = dict(trained_options(trained_with) if trained_with else {})
        if normalize is not None:
            given["normalize"] = normalize
        policy = convert(archive, network=network, **given)
        if "normalisation" in policy.info and "normalize" not in given:
            typer.echo(f"{archive}: normalised by '{policy.info['normalisation']}' beside it", err=True)
    else:
        policy = Policy.load(archive)
    if out is not None:
        typer.echo(f"policy in '{policy.save(out)}'")
    if plain_c is not None:
        from .policy_in_c import export_c

        header, source = export_c(policy, plain_c)
        typer.echo(f"C in '{header}' and '{source}'")
    if onnx is not None:
        from .onnx import export_onnx

        typer.echo(f"ONNX in '{export_onnx(policy, onnx)}'")
    if hub is not None:
        from isd_gym._commands.console import progress

        with progress() as update:
            typer.echo(f"'{wing('hub').write(policy, hub, progress=update)}' can be uploaded")


def _controller(name: str, out: Path | None, onnx: Path | None, plain_c: Path | None, network: str) -> bool:
    """Write the baseline of a name as C; return False for other names."""
    from isd_gym.baselines import CONTROLLERS, make

    from .mpc_in_c import export_c

    if name not in CONTROLLERS:
        return False
    if plain_c is None or out is not None or onnx is not None:
        raise InputError(f"'{name}' is a controller and no network: it can be written with --c DIR alone")
    controller: Any = make(name, network)
    header, source = export_c(controller, plain_c)
    typer.echo(f"C in '{header}' and '{source}'")
    return True
