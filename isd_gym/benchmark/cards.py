"""Benchmark cards (`isd-card/1`): results of the references of an environment's version, episode by episode.

A card is frozen with a version of the environment. Other scores are paired with the card on the same roads
without another run of the references: ``isd-gym score my-policy --against ISDSuspension-v0``, or ``isd-gym
card their-score.json`` for a received file. A fingerprint of every road tells whether the roads are the same.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._common.errors import InputError, shown
from .._common.inputs import read_json
from .._common.version import __version__
from ..records.schemas import check
from .scoring import compare

SCHEMA, SCORE = "isd-card/1", "isd-score/1"
BUILT_IN = Path(__file__).parent / "references"
#: keys that must agree for two scores on the same roads, and tolerance of the roads' fingerprints
SAME = ("network", "road", "speed", "episodes", "duration", "seed")
CLOSE = 1e-6


def load(name: str | Path) -> dict[str, Any]:
    """Read a card."""
    path = Path(name)
    if str(name) in built_in():
        path = BUILT_IN / f"{name}.json"
    data = read_json(
        path, f"cannot read card {shown(str(name))} (built in: {', '.join(built_in())})"
    )
    if not (isinstance(data, dict) and data.get("schema") == SCHEMA):
        raise InputError(f"card {shown(str(name))}: its schema is not '{SCHEMA}'")
    if data.get("digest") != digest(data):
        raise InputError(f"card {shown(str(name))} was altered: its digest is another")
    check(data, SCHEMA, f"card {shown(str(name))}")
    for one in data["tracks"]:
        for policy, found in one["policies"].items():
            lengths = {len(values) for values in found["episodes"].values()}
            if lengths != {one["episodes"]}:
                raise InputError(
                    f"card {shown(str(name))}: {shown(policy)} must have {one['episodes']} episodes of each quantity"
                )
    return data


def read_score(path: str | Path) -> dict[str, Any]:
    """Read a score for comparison with a card."""
    where = f"score {shown(str(path))}"
    data = read_json(path, f"{where} cannot be read")
    if not (isinstance(data, dict) and data.get("schema") == SCORE):
        raise InputError(f"{shown(str(path))} is no score ({SCORE})")
    check(data, SCORE, where)
    for key in (*SAME, "version"):
        if key not in data:
            raise InputError(
                f"{where} has no {shown(key)}; score again with this version"
            )
    return data


def built_in() -> list[str]:
    """Return the names of the cards in the package."""
    return sorted(p.stem for p in BUILT_IN.glob("*.json"))


def digest(card: Mapping[str, Any]) -> str:
    """Return the SHA-256 digest of a card without its digest."""
    text = json.dumps({k: v for k, v in card.items() if k != "digest"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def track(score: Mapping[str, Any], name: str, command: str) -> dict[str, Any]:
    """Return a track of a card from a score."""
    raw = _episodes(score)
    rows = {row["policy"]: row for row in score["policies"]}
    return {
        "track": name,
        "command": command,
        **{key: score[key] for key in SAME},
        "roads": score["roads"],
        "policies": {
            policy: {
                "preview": rows.get(policy, {}).get("preview", {}).get("value", 0.0),
                "units": {
                    k: rows[policy][k]["unit"]
                    for k in values
                    if k in rows.get(policy, {})
                },
                "episodes": values,
            }
            for policy, values in raw.items()
        },
    }


def make(
    environment: str, tracks: Sequence[Mapping[str, Any]], date: str
) -> dict[str, Any]:
    """Return a card with its digest."""
    card = {
        "schema": SCHEMA,
        "environment": environment,
        "date": date,
        "version": __version__,
        "tracks": list(tracks),
    }
    return {**card, "digest": digest(card)}


def _episodes(score: Mapping[str, Any]) -> dict[str, dict[str, list[float]]]:
    raw = score.get("raw")
    if not (isinstance(raw, dict) and isinstance(score.get("roads"), list)):
        raise InputError(
            "the score holds no single episodes; score again with this version and --json"
        )
    count = score.get("episodes")
    for policy, values in raw.items():
        if not isinstance(values, dict) or not values or "cost" not in values:
            raise InputError(f"the episodes of {shown(policy)} have no cost")
        for name, own in values.items():
            good = (
                isinstance(own, list)
                and len(own) == count
                and all(type(v) in (int, float) for v in own)
            )
            if not (good and np.isfinite(own).all()):
                raise InputError(
                    f"{shown(policy)}: {shown(name)} must be {count} finite numbers"
                )
    return raw


def _release(data: Mapping[str, Any]) -> list[str]:
    """Return the first two numbers of the version of a score or a card, within which figures stay the same."""
    return str(data.get("version")).split(".")[:2]


def match(score: Mapping[str, Any], card: Mapping[str, Any]) -> dict[str, Any]:
    """Return the track of a card with the roads of a score."""
    if _release(score) != _release(card):
        raise InputError(
            f"the score is of version {score.get('version')}, the card of version {card['version']}: score again with "
            f"version {card['version']}"
        )
    whys = []
    shown_road = (row.get("preview", {}).get("value", 0.0) for row in score["policies"])
    ahead = max(shown_road, default=0.0)
    for one in card["tracks"]:
        differ = [key for key in SAME if score.get(key) != one[key]]
        if ahead != max(p["preview"] for p in one["policies"].values()):
            differ.append("preview")
        if score.get("sensors"):
            differ.append("sensors")
        if differ:
            whys.append(f"{one['track']}: another {', '.join(differ)}")
            continue
        try:
            own = np.array(score["roads"], float)
            other = np.array(one["roads"], float)
        except (KeyError, TypeError, ValueError):
            raise InputError("the score does not say which roads it is on") from None
        if own.shape != other.shape or not np.allclose(
            own, other, rtol=CLOSE, atol=CLOSE * np.abs(other).max()
        ):
            raise InputError(
                f"the score's roads are not those of {card['environment']}"
            )
        return one
    raise InputError(
        f"the score is on no track of {card['environment']} ({'; '.join(whys)})"
    )


def ranking(
    card: Mapping[str, Any],
    name: str,
    scores: Sequence[Mapping[str, Any]] = (),
) -> list[dict[str, Any]]:
    """Return all policies of a track and of scores on the track, best first.

    Quantities are compared with the passive car. Each submitted policy's cost is compared `against` every
    other policy, paired, with 95 % intervals.
    """
    one = next((t for t in card["tracks"] if t["track"] == name), None)
    if one is None:
        raise InputError(
            f"the card has no track {shown(name)}: {', '.join(t['track'] for t in card['tracks'])}"
        )
    ground = one["policies"]["passive"]["episodes"]
    units = {
        k: unit for p in one["policies"].values() for k, unit in p["units"].items()
    }
    held = {policy: p["episodes"] for policy, p in one["policies"].items()}
    theirs: list[str] = []
    for score in scores:
        match(score, {**card, "tracks": [one]})
        for policy, values in _episodes(score).items():
            if policy in held and np.allclose(
                values["cost"], held[policy]["cost"], rtol=CLOSE, atol=0.0
            ):
                continue  # a reference that was driven again, possibly on another machine
            label = policy if policy not in held else f"{policy} (submitted)"
            held[label] = values
            theirs.append(label)
    rows = []
    for policy, values in held.items():
        row: dict[str, Any] = {"policy": policy, "submitted": policy in theirs}
        row |= {
            k: compare(
                k, np.array(v, float), np.array(ground[k], float), units.get(k, "")
            )
            for k, v in values.items()
            if k in ground
        }
        if policy in theirs:
            own = np.array(values["cost"], float)
            costs = {
                q: np.array(v["cost"], float) for q, v in held.items() if q != policy
            }
            row["against"] = {q: compare("cost", own, c, "-") for q, c in costs.items()}
        rows.append(row)
    return sorted(rows, key=lambda row: row["cost"]["value"])
